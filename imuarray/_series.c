/* Passes over long series: medians of windows that move, figures of consecutive windows, sums of second differences, products
   of rows with later ones, and sums of powers in parts. `imuarray.series` has the Python side; NumPy does the same, to rounding, by
   sorting every window and by an array for each step. */

#include "_buffers.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#define WIDEST 256 /* rows of a window whose median moves */
#define LANES 8    /* partial sums, which a processor adds at once */

/* With and without AVX2 (`CLONES`) sums are added in the same order. */

/* The first place in `sorted` (count) whose value is not below `value`. */
static Py_ssize_t place_of(const double *sorted, Py_ssize_t count, double value) {
    Py_ssize_t low = 0;
    while (count > 0) {
        const Py_ssize_t half = count / 2;
        if (sorted[low + half] < value) {
            low += half + 1;
            count -= half + 1;
        } else
            count = half;
    }
    return low;
}

static void insert(double *sorted, Py_ssize_t *count, double value) {
    const Py_ssize_t at = place_of(sorted, *count, value);
    memmove(sorted + at + 1, sorted + at, (size_t)DOUBLES(*count - at));
    sorted[at] = value;
    ++*count;
}

static void discard(double *sorted, Py_ssize_t *count, double value) {
    const Py_ssize_t at = place_of(sorted, *count, value);
    --*count;
    memmove(sorted + at, sorted + at + 1, (size_t)DOUBLES(*count - at));
}

/* Medians of the heights (n), none of them NaN, from first (b) on, side (b) of each; 0 if a window is too wide, empty or
   beyond the end. */
static int medians_of(const double *height, Py_ssize_t n, const int64_t *first, const int64_t *side, Py_ssize_t b,
                      double *result) {
    double sorted[WIDEST];
    Py_ssize_t count = 0, from = 0, to = 0;
    for (Py_ssize_t i = 0; i < b; i++) {
        const Py_ssize_t start = (Py_ssize_t)first[i], stop = start + (Py_ssize_t)side[i];
        if (start < 0 || side[i] < 1 || side[i] > WIDEST || stop > n) return 0;
        if (start < from || start >= to || stop < to || stop - from > WIDEST) { /* begin again */
            count = 0;
            from = to = start;
        }
        while (to < stop) insert(sorted, &count, height[to++]);
        while (from < start) discard(sorted, &count, height[from++]);
        result[i] = count % 2 ? sorted[count / 2] : (sorted[count / 2 - 1] + sorted[count / 2]) / 2;
    }
    return 1;
}

static PyObject *medians(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, b;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &n, &b)) return NULL;
    if (!sizes_allowed(n >= 0 && b >= 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(n), 8 * b, 8 * b, DOUBLES(b)};
    Py_buffer views[4];
    Py_ssize_t held = hold(sequence, views, 4, bytes, 3);
    int done = 0;
    if (!PyErr_Occurred()) done = medians_of(views[0].buf, n, views[1].buf, views[2].buf, b, views[3].buf);
    while (held > 0) PyBuffer_Release(&views[--held]);
    return PyErr_Occurred() ? NULL : PyBool_FromLong(done);
}

/* Add to the figures of w windows of a width those of counts (n, 3) at increasing times (n), turned by a matrix (3, 3):
   rows (w), sums (w, 3), squares (w, 3), lowest (w, 3), highest (w, 3). Rows with one of the flags are left out. */
static void windows_in(const int64_t *time, const int16_t *counts, const uint16_t *status, const double *turn, double *rows,
                       double *figures, Py_ssize_t n, Py_ssize_t w, int64_t begin, int64_t width, int flags) {
    Py_ssize_t i = 0;
    while (i < n && time[i] < begin) i++;
    while (i < n) {
        const int64_t window = (time[i] - begin) / width, end = begin + (window + 1) * width;
        if (window >= w) return;
        double number = 0, sum[3] = {0}, square[3] = {0}, low[3], high[3];
        for (int axis = 0; axis < 3; axis++) low[axis] = HUGE_VAL, high[axis] = -HUGE_VAL;
        for (; i < n && time[i] < end; i++) {
            if (status[i] & flags) continue;
            const double x = counts[3 * i], y = counts[3 * i + 1], z = counts[3 * i + 2];
            number += 1;
            for (int axis = 0; axis < 3; axis++) {
                const double value = (turn[3 * axis] * x + turn[3 * axis + 1] * y) + turn[3 * axis + 2] * z;
                sum[axis] += value;
                square[axis] += value * value;
                low[axis] = value < low[axis] ? value : low[axis];
                high[axis] = value > high[axis] ? value : high[axis];
            }
        }
        rows[window] += number;
        for (int axis = 0; axis < 3; axis++) {
            double *own = figures + 3 * window + axis;
            own[0] += sum[axis];
            own[3 * w] += square[axis];
            own[6 * w] = low[axis] < own[6 * w] ? low[axis] : own[6 * w];
            own[9 * w] = high[axis] > own[9 * w] ? high[axis] : own[9 * w];
        }
    }
}

static PyObject *windows(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, w;
    long long begin, width;
    int flags;
    if (!PyArg_ParseTuple(args, "O!(nn)LLi", &PyTuple_Type, &sequence, &n, &w, &begin, &width, &flags)) return NULL;
    if (!sizes_allowed(n >= 0 && w > 0 && width > 0)) return NULL;
    const Py_ssize_t bytes[] = {8 * n, 6 * n, 2 * n, DOUBLES(9), DOUBLES(w), DOUBLES(12 * w)};
    Py_buffer views[6];
    Py_ssize_t held = hold(sequence, views, 6, bytes, 4);
    if (!PyErr_Occurred())
        windows_in(views[0].buf, views[1].buf, views[2].buf, views[3].buf, views[4].buf, views[5].buf, n, w, begin, width,
                   flags);
    return released(views, held);
}

#define SQUARES(name, type)                                                                                              \
    CLONES static double name(const type *x, Py_ssize_t m, Py_ssize_t start, Py_ssize_t stop) {                          \
        double sums[LANES] = {0}, total = 0;                                                                             \
        Py_ssize_t end = start;                                                                                          \
        for (; end + LANES <= stop; end += LANES)                                                                        \
            for (int lane = 0; lane < LANES; lane++) {                                                                   \
                const double middle = x[end - m + lane];                                                                 \
                const double change = (x[end + lane] - middle) - (middle - x[end - 2 * m + lane]);                       \
                sums[lane] += change * change;                                                                           \
            }                                                                                                            \
        for (; end < stop; end++) {                                                                                      \
            const double middle = x[end - m], change = (x[end] - middle) - (middle - x[end - 2 * m]);                    \
            total += change * change;                                                                                    \
        }                                                                                                                \
        for (int lane = 0; lane < LANES; lane++) total += sums[lane];                                                    \
        return total;                                                                                                    \
    }
SQUARES(squares_of_whole, int32_t)
SQUARES(squares_of_real, double)

/* Add to totals (d) the sums of the squares of the second differences of x (n) at distances (d), which end from `start` to
   `stop`. */
static PyObject *second_differences(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, d, size, start, stop;
    if (!PyArg_ParseTuple(args, "O!(nn)nnn", &PyTuple_Type, &sequence, &n, &d, &size, &start, &stop)) return NULL;
    if (!sizes_allowed(n >= 0 && d >= 0 && (size == 4 || size == 8) && start >= 0 && stop <= n)) return NULL;
    const Py_ssize_t bytes[] = {size * n, 8 * d, DOUBLES(d)};
    Py_buffer views[3];
    Py_ssize_t held = hold(sequence, views, 3, bytes, 2);
    for (Py_ssize_t i = 0; i < d && !PyErr_Occurred(); i++) {
        const int64_t m = ((const int64_t *)views[1].buf)[i];
        if (m < 1) {
            PyErr_SetString(PyExc_ValueError, "a distance is not positive");
            break;
        }
        if (m > stop / 2) continue;
        const Py_ssize_t first = start > 2 * m ? start : (Py_ssize_t)(2 * m);
        double *total = (double *)views[2].buf + i;
        *total += size == 4 ? squares_of_whole(views[0].buf, (Py_ssize_t)m, first, stop)
                            : squares_of_real(views[0].buf, (Py_ssize_t)m, first, stop);
    }
    return released(views, held);
}

/* The sum of the products of x (n) with the values so many rows later. */
CLONES static double lagged_product(const double *x, Py_ssize_t n, Py_ssize_t lag) {
    double sums[LANES] = {0}, total = 0;
    Py_ssize_t i = 0;
    for (; i + LANES <= n - lag; i += LANES)
        for (int lane = 0; lane < LANES; lane++) sums[lane] += x[i + lane] * x[i + lag + lane];
    for (; i < n - lag; i++) total += x[i] * x[i + lag];
    for (int lane = 0; lane < LANES; lane++) total += sums[lane];
    return total;
}

/* Products (r, l) of r lines (r, n) with themselves, 0 to l - 1 rows later. */
static PyObject *lagged_products(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t r, n, l;
    if (!PyArg_ParseTuple(args, "O!(nnn)", &PyTuple_Type, &sequence, &r, &n, &l)) return NULL;
    if (!sizes_allowed(r >= 0 && n >= 0 && l >= 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(r * n), DOUBLES(r * l)};
    Py_buffer views[2];
    Py_ssize_t held = hold(sequence, views, 2, bytes, 1);
    for (Py_ssize_t line = 0; line < r && !PyErr_Occurred(); line++)
        for (Py_ssize_t lag = 0; lag < l; lag++)
            ((double *)views[1].buf)[line * l + lag] =
                lag < n ? lagged_product((const double *)views[0].buf + line * n, n, lag) : 0.0;
    return released(views, held);
}

/* Sums of the powers 1 to 4 of x (n), which a processor adds in lanes, to sums (4) that are `apart` from each other. */
CLONES static void add_powers(const double *x, Py_ssize_t n, double *sums, Py_ssize_t apart) {
    double lanes[4][LANES] = {{0}}, rest[4] = {0};
    Py_ssize_t i = 0;
    for (; i + LANES <= n; i += LANES)
        for (int lane = 0; lane < LANES; lane++) {
            const double value = x[i + lane], square = value * value, cube = square * value;
            lanes[0][lane] += value;
            lanes[1][lane] += square;
            lanes[2][lane] += cube;
            lanes[3][lane] += cube * value;
        }
    for (; i < n; i++) {
        const double value = x[i], square = value * value, cube = square * value;
        rest[0] += value;
        rest[1] += square;
        rest[2] += cube;
        rest[3] += cube * value;
    }
    for (int power = 0; power < 4; power++) {
        for (int lane = 0; lane < LANES; lane++) rest[power] += lanes[power][lane];
        sums[power * apart] = rest[power];
    }
}

/* Sums (4, s, k) of the powers of k lines (k, n) in parts that begin at starts (s), ascending. */
static PyObject *part_powers(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t k, n, s;
    if (!PyArg_ParseTuple(args, "O!(nnn)", &PyTuple_Type, &sequence, &k, &n, &s)) return NULL;
    if (!sizes_allowed(k >= 0 && n >= 0 && s >= 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(k * n), 8 * s, DOUBLES(4 * s * k)};
    Py_buffer views[3];
    Py_ssize_t held = hold(sequence, views, 3, bytes, 2);
    for (Py_ssize_t part = 0; part < s && !PyErr_Occurred(); part++) {
        const int64_t *starts = views[1].buf;
        const int64_t start = starts[part], stop = part + 1 < s ? starts[part + 1] : (int64_t)n;
        if (start < 0 || stop < start || stop > n) {
            PyErr_SetString(PyExc_ValueError, "the starts are not ascending rows");
            break;
        }
        for (Py_ssize_t line = 0; line < k; line++)
            add_powers((const double *)views[0].buf + line * n + start, (Py_ssize_t)(stop - start),
                       (double *)views[2].buf + part * k + line, s * k);
    }
    return released(views, held);
}

/* Sums of the second and fourth powers of the second differences of x at a distance, of `count` of them `stride` apart. */
CLONES static void add_changes(const double *x, Py_ssize_t count, Py_ssize_t distance, Py_ssize_t stride, double *square,
                               double *fourth) {
    double squares[LANES] = {0}, fourths[LANES] = {0};
    Py_ssize_t i = 0;
    for (; i + LANES <= count; i += LANES)
        for (int lane = 0; lane < LANES; lane++) {
            const double *at = x + (i + lane) * stride;
            const double change = (at[2 * distance] - at[distance]) - (at[distance] - at[0]), size = change * change;
            squares[lane] += size;
            fourths[lane] += size * size;
        }
    for (; i < count; i++) {
        const double *at = x + i * stride;
        const double change = (at[2 * distance] - at[distance]) - (at[distance] - at[0]), size = change * change;
        squares[0] += size;
        fourths[0] += size * size;
    }
    *square = *fourth = 0;
    for (int lane = 0; lane < LANES; lane++) *square += squares[lane], *fourth += fourths[lane];
}

/* For d rows (d, 4) of first, count, distance and stride: sums (2, d, k) of the second and fourth powers of the second
   differences of k lines (k, m). */
static PyObject *change_powers(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t k, m, d;
    if (!PyArg_ParseTuple(args, "O!(nnn)", &PyTuple_Type, &sequence, &k, &m, &d)) return NULL;
    if (!sizes_allowed(k >= 0 && m >= 0 && d >= 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(k * m), 8 * 4 * d, DOUBLES(2 * d * k)};
    Py_buffer views[3];
    Py_ssize_t held = hold(sequence, views, 3, bytes, 2);
    for (Py_ssize_t row = 0; row < d && !PyErr_Occurred(); row++) {
        const int64_t *each = (const int64_t *)views[1].buf + 4 * row;
        const int64_t first = each[0], count = each[1], distance = each[2], stride = each[3];
        if (first < 0 || count < 0 || distance < 1 || stride < 1 || count > m || stride > m || distance > m ||
            (count && first + (count - 1) * stride + 2 * distance >= m)) {
            PyErr_SetString(PyExc_ValueError, "a difference lies beyond the line");
            break;
        }
        double *sums = (double *)views[2].buf + row * k;
        for (Py_ssize_t line = 0; line < k; line++)
            add_changes((const double *)views[0].buf + line * m + first, (Py_ssize_t)count, (Py_ssize_t)distance,
                        (Py_ssize_t)stride, sums + line, sums + d * k + line);
    }
    return released(views, held);
}

static PyMethodDef methods[] = {
    {"part_powers", part_powers, METH_VARARGS, "part_powers(arrays, sizes): sums of powers in parts of lines."},
    {"change_powers", change_powers, METH_VARARGS, "change_powers(arrays, sizes): sums of powers of second differences."},
    {"lagged_products", lagged_products, METH_VARARGS, "lagged_products(arrays, sizes): of lines with themselves, later."},
    {"medians", medians, METH_VARARGS, "medians(arrays, sizes): medians of windows, and whether all were possible."},
    {"windows", windows, METH_VARARGS, "windows(arrays, sizes, begin, width, flags): figures of consecutive windows."},
    {"second_differences", second_differences, METH_VARARGS,
     "second_differences(arrays, sizes, size, start, stop): sums of squares at several distances."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_series", "Passes over series.", 0, methods, slots, NULL,
                                        NULL, NULL};

PyMODINIT_FUNC PyInit__series(void) { return PyModuleDef_Init(&definition); }

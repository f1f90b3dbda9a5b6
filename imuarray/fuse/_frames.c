/* Passes over frames that `imuarray.fuse.alignment` and `imuarray.fuse.least_squares` also do with NumPy and SciPy: triads by
   a constant gain, the readings of a sensor on the grid, the consensus of the sensors, splines between frames, the removal of
   the motion since a frame, and covariances. NumPy writes and reads an array for each step of them; here the intermediate results of a few frames stay
   in the cache. The Python code explains every step. The results are the same to rounding, of readings and of splines to
   the bit. */

#include "../_buffers.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#define TILE 32  /* frames that are processed at once */
#define MOST 96  /* axes */
#define EACH for (int f = 0; f < TILE; f++)

/* With and without AVX2 (`CLONES`) products and sums are not contracted, so that both give the same bits. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

/* Triads (3, n) = gain (3, m) @ counts (m, n) less `of_bias` (3); `gain` is stored (m, 4), with a zero after each column, and
   the counts in `parts` arrays (n, width) of the sensors. */
CLONES static void combine(const int16_t *const *counts, const Py_ssize_t *widths, Py_ssize_t parts, const double *gain,
                           const double *of_bias, double *into, Py_ssize_t n) {
    for (Py_ssize_t first = 0; first < n; first += TILE) {
        const Py_ssize_t count = n - first < TILE ? n - first : TILE;
        double sums[TILE][4];
        memset(sums, 0, sizeof sums);
        const double *factors = gain;
        for (Py_ssize_t part = 0; part < parts; part++) {
            const Py_ssize_t width = widths[part];
            const int16_t *row = counts[part] + first * width;
            for (Py_ssize_t f = 0; f < count; f++, row += width) {
                double sum[4];
                memcpy(sum, sums[f], sizeof sum);
                for (Py_ssize_t axis = 0; axis < width; axis++) {
                    const double reading = row[axis];
                    for (int i = 0; i < 4; i++) sum[i] += reading * factors[4 * axis + i];
                }
                memcpy(sums[f], sum, sizeof sum);
            }
            factors += 4 * width;
        }
        for (int i = 0; i < 3; i++)
            for (Py_ssize_t f = 0; f < count; f++) into[i * n + first + f] = sums[f][i] - of_bias[i];
    }
}

static PyObject *triads(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence, *given;
    Py_ssize_t n, axes = 0, widths[MOST], bytes[MOST + 3];
    if (!PyArg_ParseTuple(args, "O!O!n", &PyTuple_Type, &sequence, &PyTuple_Type, &given, &n)) return NULL;
    const Py_ssize_t parts = PyTuple_Size(given);
    if (!sizes_allowed(parts > 0 && parts <= MOST && n >= 0)) return NULL;
    for (Py_ssize_t part = 0; part < parts; part++) {
        widths[part] = PyLong_AsSsize_t(PyTuple_GetItem(given, part));
        if (PyErr_Occurred() || !sizes_allowed(widths[part] > 0 && widths[part] <= MOST)) return NULL;
        bytes[part] = 2 * n * widths[part];
        axes += widths[part];
    }
    bytes[parts] = DOUBLES(4 * axes);
    bytes[parts + 1] = DOUBLES(3);
    bytes[parts + 2] = DOUBLES(3 * n);
    Py_buffer views[MOST + 3];
    Py_ssize_t held = hold(sequence, views, parts + 3, bytes, parts + 2);
    if (!PyErr_Occurred()) {
        const int16_t *counts[MOST];
        for (Py_ssize_t part = 0; part < parts; part++) counts[part] = views[part].buf;
        combine(counts, widths, parts, views[parts].buf, views[parts + 1].buf, views[parts + 2].buf, n);
    }
    return released(views, held);
}

/* The reading nearest to each frame of the increasing `grid`, within half a frame: the sum of 1 if one of them has a
   `special` flag, and of 2 if two frames have the same valid reading. */
CLONES static int readings_of(const int64_t *time, const int16_t *counts, const uint16_t *status, const int64_t *grid,
                              const double *bias, const double *scale, double *values, char *valid, char *stale,
                              double *late, Py_ssize_t k, Py_ssize_t n, int64_t half_ns, double age_ns, int special,
                              int doubtful, int stale_flag) {
    Py_ssize_t row = 0, before = -1;
    int seen = 0, shared = 0;
    for (Py_ssize_t i = 0; i < n; i++) {
        while (row + 1 < k && time[row] + time[row + 1] < 2 * grid[i]) row++;
        const int64_t apart = time[row] - grid[i];
        const int near = apart <= half_ns && apart >= -half_ns, flags = near ? status[row] : 0;
        seen |= flags;
        valid[i] = (char)(near && !(flags & doubtful));
        shared |= valid[i] && row == before;
        before = valid[i] ? row : -1;
        stale[i] = (flags & stale_flag) != 0;
        late[i] = near ? ((double)apart - age_ns) * 1e-9 : 0.0;
        for (int axis = 0; axis < 3; axis++)
            values[axis * n + i] = near ? ((double)counts[3 * row + axis] - bias[axis]) / scale[axis] : 0.0;
    }
    return ((seen & special) != 0) + 2 * shared;
}

static PyObject *readings(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t k, n;
    long long half_ns;
    double age_ns;
    int special, doubtful, stale;
    if (!PyArg_ParseTuple(args, "O!(nn)Ld(iii)", &PyTuple_Type, &sequence, &k, &n, &half_ns, &age_ns, &special, &doubtful,
                          &stale))
        return NULL;
    if (!sizes_allowed(k > 0 && n >= 0)) return NULL;
    const Py_ssize_t bytes[] = {8 * k, 6 * k, 2 * k, 8 * n, DOUBLES(3), DOUBLES(3), DOUBLES(3 * n), n, n, DOUBLES(n)};
    Py_buffer views[10];
    Py_ssize_t held = hold(sequence, views, 10, bytes, 6);
    int seen = 0;
    if (!PyErr_Occurred())
        seen = readings_of(views[0].buf, views[1].buf, views[2].buf, views[3].buf, views[4].buf, views[5].buf, views[6].buf,
                           views[7].buf, views[8].buf, views[9].buf, k, n, half_ns, age_ns, special, doubtful, stale);
    while (held > 0) PyBuffer_Release(&views[--held]);
    return PyErr_Occurred() ? NULL : PyLong_FromLong(seen);
}

typedef double Line[TILE];

/* into (3) = gain (3, m) @ lines (m). */
INLINE void product(const double *gain, Line *lines, Py_ssize_t m, Line *into) {
    for (int i = 0; i < 3; i++) {
        Line sum;
        EACH sum[f] = 0;
        for (Py_ssize_t axis = 0; axis < m; axis++) {
            const double factor = gain[i * m + axis];
            EACH sum[f] += factor * lines[axis][f];
        }
        memcpy(into[i], sum, sizeof sum);
    }
}

/* Sort `count` lines frame by frame: merge exchange (D. E. Knuth, "Sorting and Searching", 1998, algorithm 5.2.2 M). */
INLINE void sort(Line *lines, Py_ssize_t count) {
    Py_ssize_t top = 1;
    while (2 * top < count) top *= 2;
    for (Py_ssize_t p = top; p > 0; p /= 2) {
        Py_ssize_t q = top, r = 0, d = p;
        for (;;) {
            for (Py_ssize_t i = 0; i + d < count; i++) {
                if ((i & p) != r) continue;
                double *low = lines[i], *high = lines[i + d];
                EACH {
                    const double a = low[f], b = high[f];
                    low[f] = a < b ? a : b;
                    high[f] = a < b ? b : a;
                }
            }
            if (q == p) break;
            d = q - p;
            q /= 2;
            r = p;
        }
    }
}

INLINE void median(Line *lines, Py_ssize_t count, double *into) {
    if (count > 1) sort(lines, count);
    const double *low = lines[(count - 1) / 2], *high = lines[count / 2];
    EACH into[f] = (low[f] + high[f]) / 2;
}

/* What remains of the values (m) after the triad (3) along each axis. */
INLINE void residuals(Line *values, Line *triad, const double *rows, Py_ssize_t m, Line *into) {
    for (Py_ssize_t axis = 0; axis < m; axis++) {
        const double x = rows[3 * axis], y = rows[3 * axis + 1], z = rows[3 * axis + 2];
        EACH into[axis][f] = values[axis][f] - ((x * triad[0][f] + y * triad[1][f]) + z * triad[2][f]);
    }
}

/* The consensus (3) of a tile of frames whose readings are all valid. */
CLONES static void agree(Line *values, const double *rows, const double *gain, const double *inverse, double tolerated,
                         Py_ssize_t m, Line *mean) {
    static const double most_usual = 4.0; /* `_TIMES_USUAL` */
    const Py_ssize_t sensors = m / 3;
    Line apart[MOST], far[MOST], triads[MOST / 3], middle[3], more[3], usual, worst;
    product(gain, values, m, mean);
    if (sensors < 3) return; /* two sensors don't show which of them is wrong */
    residuals(values, mean, rows, m, apart);
    EACH worst[f] = 0;
    for (Py_ssize_t axis = 0; axis < m; axis++)
        EACH worst[f] = fabs(apart[axis][f]) > worst[f] ? fabs(apart[axis][f]) : worst[f];
    int doubtful = 0;
    EACH doubtful |= worst[f] > tolerated / 2;
    if (!doubtful) return;
    Line agreed[3];
    memcpy(agreed, mean, sizeof agreed);
    for (int i = 0; i < 3; i++) {
        for (Py_ssize_t sensor = 0; sensor < sensors; sensor++) {
            const double *row = inverse + 9 * sensor + 3 * i;
            Line *own = values + 3 * sensor;
            EACH triads[sensor][f] = (row[0] * own[0][f] + row[1] * own[1][f]) + row[2] * own[2][f];
        }
        median(triads, sensors, middle[i]);
    }
    residuals(values, middle, rows, m, apart);
    for (Py_ssize_t axis = 0; axis < m; axis++) EACH far[axis][f] = fabs(apart[axis][f]);
    Line most[MOST / 3];
    for (Py_ssize_t sensor = 0; sensor < sensors; sensor++) {
        Line *own = far + 3 * sensor;
        EACH {
            const double larger = own[0][f] > own[1][f] ? own[0][f] : own[1][f];
            most[sensor][f] = larger > own[2][f] ? larger : own[2][f];
        }
    }
    median(far, m, usual);
    EACH usual[f] = tolerated + most_usual * usual[f];
    for (Py_ssize_t sensor = 0; sensor < sensors; sensor++) {
        Line share;
        EACH {
            const double part = usual[f] / (most[sensor][f] > 1e-300 ? most[sensor][f] : 1e-300);
            share[f] = part < 1.0 ? part : 1.0;
        }
        for (int i = 0; i < 3; i++) EACH apart[3 * sensor + i][f] *= share[f];
    }
    product(gain, apart, m, more);
    for (int i = 0; i < 3; i++)
        EACH mean[i][f] = worst[f] > tolerated / 2 ? middle[i][f] + more[i][f] : agreed[i][f];
}

static PyObject *consensus(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t m, n;
    double tolerated;
    if (!PyArg_ParseTuple(args, "O!(nn)d", &PyTuple_Type, &sequence, &m, &n, &tolerated)) return NULL;
    if (!sizes_allowed(m >= 3 && m <= MOST && m % 3 == 0 && n >= 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(m * n), DOUBLES(3 * m), DOUBLES(3 * m), DOUBLES(3 * m), DOUBLES(3 * n)};
    Py_buffer views[5];
    Py_ssize_t held = hold(sequence, views, 5, bytes, 4);
    if (!PyErr_Occurred()) {
        const double *values = views[0].buf;
        double *mean = views[4].buf;
        for (Py_ssize_t first = 0; first < n; first += TILE) {
            Line tile[MOST], result[3];
            const Py_ssize_t count = n - first < TILE ? n - first : TILE;
            for (Py_ssize_t axis = 0; axis < m; axis++) {
                memset(tile[axis], 0, sizeof tile[axis]);
                memcpy(tile[axis], values + axis * n + first, (size_t)DOUBLES(count));
            }
            agree(tile, views[1].buf, views[2].buf, views[3].buf, tolerated, m, result);
            for (int i = 0; i < 3; i++) memcpy(mean + i * n + first, result[i], (size_t)DOUBLES(count));
        }
    }
    return released(views, held);
}

/* columns (3 s, n) less, along the direction (3 s, 3) of each axis, the change of the motion from the frame to the reading:
   (slope (3, n) - share * usual * curvature (3, n)) * late (s, n), usual the mean of the late times of valid (s, n). */
CLONES static void less_motion(double *columns, const double *slope, const double *curvature, const char *valid,
                               const double *late, const double *directions, Py_ssize_t s, Py_ssize_t n, double share) {
    for (Py_ssize_t first = 0; first < n; first += TILE) {
        const Py_ssize_t count = n - first < TILE ? n - first : TILE;
        Line sum, known, way[3];
        EACH sum[f] = known[f] = 0;
        for (Py_ssize_t sensor = 0; sensor < s; sensor++) {
            const double *own = late + sensor * n + first;
            const char *sound = valid + sensor * n + first;
            for (Py_ssize_t f = 0; f < count; f++) {
                sum[f] += own[f] * (double)sound[f];
                known[f] += (double)sound[f];
            }
        }
        EACH sum[f] = sum[f] / (known[f] > 1.0 ? known[f] : 1.0) * share;
        for (int i = 0; i < 3; i++)
            for (Py_ssize_t f = 0; f < count; f++)
                way[i][f] = slope[i * n + first + f] - sum[f] * curvature[i * n + first + f];
        for (Py_ssize_t axis = 0; axis < 3 * s; axis++) {
            const double x = directions[3 * axis], y = directions[3 * axis + 1], z = directions[3 * axis + 2];
            const double *own = late + axis / 3 * n + first;
            double *column = columns + axis * n + first;
            for (Py_ssize_t f = 0; f < count; f++)
                column[f] -= ((x * way[0][f] + y * way[1][f]) + z * way[2][f]) * own[f];
        }
    }
}

static PyObject *motion(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t s, n;
    double share;
    if (!PyArg_ParseTuple(args, "O!(nn)d", &PyTuple_Type, &sequence, &s, &n, &share)) return NULL;
    if (!sizes_allowed(s > 0 && n >= 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(3 * n), DOUBLES(3 * n), s * n, DOUBLES(s * n), DOUBLES(9 * s), DOUBLES(3 * s * n)};
    Py_buffer views[6];
    Py_ssize_t held = hold(sequence, views, 6, bytes, 5);
    if (!PyErr_Occurred())
        less_motion(views[5].buf, views[0].buf, views[1].buf, views[2].buf, views[3].buf, views[4].buf, s, n, share);
    return released(views, held);
}

/* `Frames.delay_noise` (2 s, n); `_delay_noise` and `_noise_of_slopes` explain every step and the `weights`. */
static void noise_of_delays(const int64_t *grid, const double *slope, const char *valid, const double *late, float *noise,
                            Py_ssize_t s, Py_ssize_t n, double period_ns, double longest_ns, const double *weights) {
    const double period_s = period_ns * 1e-9;
    int incomplete = 0;
    for (Py_ssize_t i = 0; i < s * n && s > 1 && !incomplete; i++) incomplete = !valid[i];
    double variance[3] = {1, 1, 1}; /* of the mean of the frame before, of this and of the next frame */
    for (Py_ssize_t i = -1; i < n; i++) {
        if (incomplete && i + 1 < n) {
            Py_ssize_t present = 0;
            for (Py_ssize_t sensor = 0; sensor < s; sensor++) present += valid[sensor * n + i + 1];
            variance[2] = (double)s / (double)(present > 1 ? present : 1);
        }
        if (i >= 0) {
            if (i == 0) variance[0] = variance[1];
            double step[4], usual = 0;
            Py_ssize_t present = 0;
            for (int k = 0; k < 4; k++) {
                Py_ssize_t from = i + k - 2;
                from = from > n - 2 ? n - 2 : from < 0 ? 0 : from;
                step[k] = n > 1 ? (double)(grid[from + 1] - grid[from]) * 1e-9 : period_s;
                if (step[k] > longest_ns * 1e-9) step[k] = period_s;
            }
            for (Py_ssize_t sensor = 0; sensor < s; sensor++) {
                usual += late[sensor * n + i] * (double)valid[sensor * n + i];
                present += valid[sensor * n + i];
            }
            usual /= (double)(present > 1 ? present : 1);
            const double mean_s = (step[0] + step[1] + step[2] + step[3]) / 4;
            const double near = (step[2] - step[1]) / mean_s, far = (step[3] - step[0]) / mean_s;
            double own = weights[0] * near + weights[1] * far;
            const double across = weights[2] * near + weights[3] * far, second = weights[9] * usual / mean_s;
            double power = weights[5] + weights[6] * (own * own) - 2 * second * across + weights[7] * (second * second);
            const double of_slope = own;
            own = own + weights[4] * second;
            if (incomplete) {
                const double later = tanh(-of_slope - weights[8] * second);
                const double others = (power - own * own > 0 ? power - own * own : 0) / 2;
                power = others * ((1 - later) * variance[0] + (1 + later) * variance[2]) + own * own * variance[1];
                own *= variance[1];
            }
            const int moves = slope[i] != 0 || slope[n + i] != 0 || slope[2 * n + i] != 0;
            const double of_all = sqrt(power > 0 ? power : 0) / mean_s;
            const float shares[2] = {moves ? (float)(own / mean_s) : 0, moves ? (float)of_all : 0};
            for (int k = 0; k < 2; k++)
                for (Py_ssize_t sensor = 0; sensor < s; sensor++)
                    noise[(k * s + sensor) * n + i] = (float)((double)shares[k] * late[sensor * n + i]);
        }
        variance[0] = variance[1];
        variance[1] = variance[2];
    }
}

static PyObject *delay_noise(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t s, n;
    double period_ns, longest_ns;
    if (!PyArg_ParseTuple(args, "O!(nn)dd", &PyTuple_Type, &sequence, &s, &n, &period_ns, &longest_ns)) return NULL;
    if (!sizes_allowed(s > 0 && n >= 0)) return NULL;
    const Py_ssize_t bytes[] = {8 * n, DOUBLES(3 * n), s * n, DOUBLES(s * n), DOUBLES(10), 8 * s * n};
    Py_buffer views[6];
    Py_ssize_t held = hold(sequence, views, 6, bytes, 5);
    if (!PyErr_Occurred())
        noise_of_delays(views[0].buf, views[1].buf, views[2].buf, views[3].buf, views[5].buf, s, n, period_ns, longest_ns,
                        views[4].buf);
    return released(views, held);
}

/* The right sides of the equations of the slopes of one column (k > 3), each over its diagonal: the slopes make the second
   derivative continuous; with those at the ends eliminated ("not a knot"), the equations are diagonally dominant. */
CLONES static void right_sides(const double *widths, const double *column, const double *diagonal, double *rises, double *x,
                               Py_ssize_t k) {
    const Py_ssize_t last = k - 1;
    for (Py_ssize_t i = 0; i < last; i++) rises[i] = (column[i + 1] - column[i]) / widths[i];
    for (Py_ssize_t i = 1; i < last; i++) x[i] = 3 * (widths[i] * rises[i - 1] + widths[i - 1] * rises[i]);
    const double first = widths[0] + widths[1], end = widths[last - 2] + widths[last - 1];
    x[0] = ((widths[0] + 2 * first) * widths[1] * rises[0] + widths[0] * widths[0] * rises[1]) / first;
    x[last] = (widths[last - 1] * widths[last - 1] * rises[last - 2] +
               (2 * end + widths[last - 1]) * widths[last - 2] * rises[last - 1]) / end;
    x[1] -= x[0];
    x[last - 1] -= x[last];
    for (Py_ssize_t i = 1; i < last; i++) x[i] /= diagonal[i];
}

static PyObject *slopes(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t c, k;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &c, &k)) return NULL;
    if (!sizes_allowed(c > 0 && k > 3)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(k - 1), DOUBLES(c * k), DOUBLES(c * k), DOUBLES(5 * k)};
    Py_buffer views[4];
    Py_ssize_t held = hold(sequence, views, 4, bytes, 2);
    if (!PyErr_Occurred()) {
        const double *widths = views[0].buf, *columns = views[1].buf;
        double *x = views[2].buf, *diagonal = views[3].buf;
        double *before = diagonal + k, *share = before + k, *scale = share + k, *rises = scale + k;
        for (Py_ssize_t i = 1; i < k - 1; i++) diagonal[i] = 2 * (widths[i - 1] + widths[i]);
        diagonal[1] = widths[0] + widths[1];
        diagonal[k - 2] = widths[k - 3] + widths[k - 2];
        for (Py_ssize_t i = 1; i < k - 1; i++) {
            before[i] = -widths[i] / diagonal[i];
            share[i] = -widths[i - 1] / diagonal[i];
        }
        before[1] = share[k - 2] = 0.0;
        scale[1] = 1.0;
        for (Py_ssize_t i = 2; i < k - 1; i++) {
            scale[i] = 1 / (1 - before[i] * share[i - 1]);
            share[i] *= scale[i];
        }
        for (Py_ssize_t line = 0; line < c; line++)
            right_sides(widths, columns + line * k, diagonal, rises, x + line * k, k);
        for (Py_ssize_t i = 2; i < k - 1; i++) /* all columns at once: each row waits for the one before */
            for (Py_ssize_t at = i; at < c * k; at += k) x[at] = (x[at] + before[i] * x[at - 1]) * scale[i];
        for (Py_ssize_t i = k - 3; i > 0; i--)
            for (Py_ssize_t at = i; at < c * k; at += k) x[at] += share[i] * x[at + 1];
        const double first = widths[0] + widths[1], end = widths[k - 3] + widths[k - 2];
        for (double *own = x; own < x + c * k; own += k) {
            own[0] = (own[0] - first * own[1]) / widths[1];
            own[k - 1] = (own[k - 1] - end * own[k - 2]) / widths[k - 3];
        }
    }
    return released(views, held);
}

/* Second derivatives (c, k) at the knots. */
static PyObject *curvatures(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t c, k;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &c, &k)) return NULL;
    if (!sizes_allowed(c > 0 && k > 1)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(k - 1), DOUBLES(c * k), DOUBLES(c * k), DOUBLES(c * k)};
    Py_buffer views[4];
    Py_ssize_t held = hold(sequence, views, 4, bytes, 3);
    for (Py_ssize_t line = 0; line < c && !PyErr_Occurred(); line++) {
        const double *widths = views[0].buf;
        const double *column = (double *)views[1].buf + line * k, *slope = (double *)views[2].buf + line * k;
        double *result = (double *)views[3].buf + line * k, square = 0, cube = 0;
        for (Py_ssize_t i = 0; i < k - 1; i++) {
            const double rise = (column[i + 1] - column[i]) / widths[i];
            const double bend = (slope[i] + slope[i + 1] - 2 * rise) / widths[i];
            square = (rise - slope[i]) / widths[i] - bend;
            cube = bend / widths[i];
            result[i] = 2 * square;
        }
        result[k - 1] = 2 * square + 6 * cube * widths[k - 2];
    }
    return released(views, held);
}

/* The spline (c, n) at increasing places (n). */
static PyObject *at(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t c, k, n;
    if (!PyArg_ParseTuple(args, "O!(nnn)", &PyTuple_Type, &sequence, &c, &k, &n)) return NULL;
    if (!sizes_allowed(c > 0 && k > 1 && n >= 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(k), DOUBLES(k - 1), DOUBLES(c * k), DOUBLES(c * k), DOUBLES(n), DOUBLES(c * n)};
    Py_buffer views[6];
    Py_ssize_t held = hold(sequence, views, 6, bytes, 5);
    for (Py_ssize_t line = 0; line < c && !PyErr_Occurred(); line++) {
        const double *knots = views[0].buf, *widths = views[1].buf, *places = views[4].buf;
        const double *column = (double *)views[2].buf + line * k, *slope = (double *)views[3].buf + line * k;
        double *result = (double *)views[5].buf + line * n, square = 0, cube = 0;
        Py_ssize_t i = 0, piece = -1;
        for (Py_ssize_t place = 0; place < n; place++) {
            while (i < k - 2 && knots[i + 1] <= places[place]) i++;
            if (i != piece) {
                const double rise = (column[i + 1] - column[i]) / widths[i];
                const double bend = (slope[i] + slope[i + 1] - 2 * rise) / widths[i];
                square = (rise - slope[i]) / widths[i] - bend;
                cube = bend / widths[i];
                piece = i;
            }
            const double beyond = places[place] - knots[i];
            result[place] = column[i] + ((beyond * cube + square) * beyond + slope[i]) * beyond;
        }
    }
    return released(views, held);
}

/* Covariances (6, n) of triads (3, n): factors (6, 10) times 1, x, y, z, xx, yy, zz, xy, xz, yz. */
CLONES static void quadratic(const double *factors, const double *triads, double *result, Py_ssize_t n) {
    for (Py_ssize_t first = 0; first < n; first += TILE) {
        const Py_ssize_t count = n - first < TILE ? n - first : TILE;
        const double *x = triads + first, *y = x + n, *z = y + n;
        for (int entry = 0; entry < 6; entry++) {
            const double *g = factors + 10 * entry;
            double *into = result + entry * n + first;
            for (Py_ssize_t f = 0; f < count; f++)
                into[f] = g[0] + x[f] * (g[1] + g[4] * x[f] + g[7] * y[f] + g[8] * z[f]) +
                          y[f] * (g[2] + g[5] * y[f] + g[9] * z[f]) + z[f] * (g[3] + g[6] * z[f]);
        }
    }
}

static PyObject *covariances(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n;
    if (!PyArg_ParseTuple(args, "O!(n)", &PyTuple_Type, &sequence, &n)) return NULL;
    if (!sizes_allowed(n >= 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(60), DOUBLES(3 * n), DOUBLES(6 * n)};
    Py_buffer views[3];
    Py_ssize_t held = hold(sequence, views, 3, bytes, 2);
    if (!PyErr_Occurred()) quadratic(views[0].buf, views[1].buf, views[2].buf, n);
    return released(views, held);
}

static PyMethodDef methods[] = {
    {"triads", triads, METH_VARARGS, "triads(arrays, widths, frames): a constant gain times counts, less a constant."},
    {"readings", readings, METH_VARARGS, "readings(arrays, sizes, half_ns, age_ns, flags): a sensor on the grid."},
    {"consensus", consensus, METH_VARARGS, "consensus(arrays, sizes, tolerated): the robust mean of the sensors."},
    {"motion", motion, METH_VARARGS, "motion(arrays, sizes, share): remove the motion since a frame from its readings."},
    {"delay_noise", delay_noise, METH_VARARGS, "delay_noise(arrays, sizes, period_ns, longest_ns): `Frames.delay_noise`."},
    {"slopes", slopes, METH_VARARGS, "slopes(arrays, sizes): first derivatives of a spline at its knots."},
    {"curvatures", curvatures, METH_VARARGS, "curvatures(arrays, sizes): second derivatives of a spline at its knots."},
    {"at", at, METH_VARARGS, "at(arrays, sizes): a spline at increasing places."},
    {"covariances", covariances, METH_VARARGS, "covariances(arrays, sizes): quadratic functions of triads."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_frames", "Passes over frames.", 0, methods, slots, NULL,
                                        NULL, NULL};

PyMODINIT_FUNC PyInit__frames(void) { return PyModuleDef_Init(&definition); }

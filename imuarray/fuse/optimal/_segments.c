/* Frames of a segment in which the same rows are in use, no axis is clipped and the usual gain serves.

   `begin` does what `SegmentView.begin`, `SegmentView.usual` and `SegmentView.reach` do for such a segment, `frames` what
   `solve`, `Dynamics` and `SegmentEvidence.add` do of its frames: a segment is some ten thousand multiplications, which
   NumPy spreads over a hundred calls. Where frames need another gain nothing is done of them; the Python code then solves
   them. The names are those of the Python code, where every step is explained.

   Sizes: n frames, r rows, k unknowns (3 or 6), t terms (1 or 4). */

#include "../../_buffers.h"

#include <math.h>
#include <string.h>

#define UNKNOWNS 6
#define TERMS 4
#define MOST_ROWS 4096

/* What `begin` leaves to `frames`, one after the other in one array. */
typedef struct {
    double *variance, *stimulus, *gain, *expected, *noise, *errors, *timing; /* (r) (3) (k,r) (k) (k,k) (t,t,k,k) (k,k) */
} Usual;

static Py_ssize_t usual_size(Py_ssize_t r, Py_ssize_t k, Py_ssize_t t) { return r + 3 + k * r + k + (2 + t * t) * k * k; }

static Usual usual_of(double *room, Py_ssize_t r, Py_ssize_t k, Py_ssize_t t) {
    Usual u;
    u.variance = room;
    u.stimulus = u.variance + r;
    u.gain = u.stimulus + 3;
    u.expected = u.gain + k * r;
    u.noise = u.expected + k;
    u.errors = u.noise + k * k;
    u.timing = u.errors + t * t * k * k;
    return u;
}

/* Solves left (size, size) @ result = right (size, columns) by elimination with the largest pivot; right becomes the
   result. 0 if left is singular. */
static int solve(double *left, double *right, Py_ssize_t size, Py_ssize_t columns) {
    for (Py_ssize_t column = 0; column < size; column++) {
        Py_ssize_t best = column;
        for (Py_ssize_t row = column + 1; row < size; row++)
            if (fabs(left[row * size + column]) > fabs(left[best * size + column])) best = row;
        if (!(fabs(left[best * size + column]) > 0)) return 0;
        if (best != column) {
            for (Py_ssize_t i = column; i < size; i++) {
                double kept = left[column * size + i];
                left[column * size + i] = left[best * size + i], left[best * size + i] = kept;
            }
            for (Py_ssize_t i = 0; i < columns; i++) {
                double kept = right[column * columns + i];
                right[column * columns + i] = right[best * columns + i], right[best * columns + i] = kept;
            }
        }
        for (Py_ssize_t row = column + 1; row < size; row++) {
            double factor = left[row * size + column] / left[column * size + column];
            if (factor == 0) continue;
            for (Py_ssize_t i = column + 1; i < size; i++) left[row * size + i] -= factor * left[column * size + i];
            for (Py_ssize_t i = 0; i < columns; i++) right[row * columns + i] -= factor * right[column * columns + i];
        }
    }
    for (Py_ssize_t row = size - 1; row >= 0; row--)
        for (Py_ssize_t i = 0; i < columns; i++) {
            double sum = right[row * columns + i];
            for (Py_ssize_t j = row + 1; j < size; j++) sum -= left[row * size + j] * right[j * columns + i];
            right[row * columns + i] = sum / left[row * size + row];
        }
    return 1;
}

/* gain (k, r) @ diag(scale^2 of every row) @ gain', into (k, k). */
static void scattered(const double *gain, const double *scale, Py_ssize_t r, Py_ssize_t k, double *into) {
    for (Py_ssize_t i = 0; i < k; i++)
        for (Py_ssize_t j = 0; j <= i; j++) {
            double sum = 0;
            for (Py_ssize_t row = 0; row < r; row++) sum += gain[i * r + row] * scale[row] * scale[row] * gain[j * r + row];
            into[i * k + j] = into[j * k + i] = sum;
        }
}

typedef struct {
    const double *rows, *noise, *timing, *offset, *errors, *values; /* (r,k) (r) (r) (r) (t,t,r,r) (r) */
    const char *used;                                              /* (r) */
} View;

/* The distance within which the usual gain serves: see `SegmentView.reach`. */
static double reach_of(const View *v, const Usual *u, Py_ssize_t r, Py_ssize_t t, double tolerance) {
    double terms[TERMS] = {1, u->stimulus[0], u->stimulus[1], u->stimulus[2]}, reach = HUGE_VAL;
    for (Py_ssize_t row = 0; row < r; row++) {
        double product[TERMS], variance = 0, slope = 0, curvature = 0;
        for (Py_ssize_t j = 0; j < t; j++) {
            product[j] = 0;
            for (Py_ssize_t l = 0; l < t; l++) product[j] += v->errors[((j * t + l) * r + row) * r + row] * terms[l];
            variance += product[j] * terms[j];
            if (j > 0) slope += product[j] * product[j], curvature += v->errors[((j * t + j) * r + row) * r + row];
        }
        double tolerated = tolerance * (u->variance[row] + fmax(variance, 0.0));
        slope = 2 * sqrt(slope), curvature = fmax(curvature, 0.0);
        reach = fmin(reach, 2 * tolerated / (slope + sqrt(slope * slope + 4 * curvature * tolerated) + 1e-300));
    }
    return reach;
}

/* Stimulus, gain and covariances of a segment; 0 where a matrix is singular. */
static int prepare(const View *v, Usual *u, Py_ssize_t r, Py_ssize_t k, Py_ssize_t t, int final, double change,
                   double *room, Py_ssize_t *in_use) {
    double normal[UNKNOWNS * UNKNOWNS] = {0}, sums[UNKNOWNS] = {0};
    Py_ssize_t p = 0;
    for (Py_ssize_t row = 0; row < r; row++) {
        u->variance[row] = v->noise[row] * v->noise[row] + v->timing[row] * v->timing[row] * change;
        if (!v->used[row]) continue;
        in_use[p++] = row;
        double precision = 1 / (v->noise[row] * v->noise[row]), value = v->values[row] - v->offset[row];
        for (Py_ssize_t i = 0; i < k; i++) {
            double weighed = v->rows[row * k + i] * precision;
            for (Py_ssize_t j = 0; j < k; j++) normal[i * k + j] += weighed * v->rows[row * k + j];
            sums[i] += weighed * value;
        }
    }
    if (!solve(normal, sums, k, 1)) return 0;
    memcpy(u->stimulus, sums, 3 * sizeof(double));

    double *weighed = room, *slow = room + r * k, *turned = slow + r * r; /* (p,k), (p,p), (r,k) */
    double terms[TERMS] = {1, u->stimulus[0], u->stimulus[1], u->stimulus[2]};
    for (Py_ssize_t a = 0; a < p; a++)
        for (Py_ssize_t i = 0; i < k; i++)
            weighed[a * k + i] = v->rows[in_use[a] * k + i] / (final ? u->variance[in_use[a]] : 1);
    if (!final) {
        memset(slow, 0, (size_t)(p * p) * sizeof(double));
        for (Py_ssize_t j = 0; j < t; j++)
            for (Py_ssize_t l = 0; l < t; l++) {
                double product = terms[j] * terms[l];
                const double *errors = v->errors + (j * t + l) * r * r;
                for (Py_ssize_t a = 0; a < p; a++)
                    for (Py_ssize_t b = 0; b < p; b++) slow[a * p + b] += product * errors[in_use[a] * r + in_use[b]];
            }
        for (Py_ssize_t a = 0; a < p; a++) slow[a * p + a] += u->variance[in_use[a]];
        if (!solve(slow, weighed, p, k)) return 0;
    }
    memset(normal, 0, sizeof(normal));
    for (Py_ssize_t a = 0; a < p; a++)
        for (Py_ssize_t i = 0; i < k; i++)
            for (Py_ssize_t j = 0; j < k; j++) normal[i * k + j] += v->rows[in_use[a] * k + i] * weighed[a * k + j];
    double *transposed = slow; /* (k,p) */
    for (Py_ssize_t a = 0; a < p; a++)
        for (Py_ssize_t i = 0; i < k; i++) transposed[i * p + a] = weighed[a * k + i];
    if (!solve(normal, transposed, k, p)) return 0;
    memset(u->gain, 0, (size_t)(k * r) * sizeof(double));
    for (Py_ssize_t i = 0; i < k; i++) {
        u->expected[i] = 0;
        for (Py_ssize_t a = 0; a < p; a++) {
            u->gain[i * r + in_use[a]] = transposed[i * p + a];
            u->expected[i] += transposed[i * p + a] * v->offset[in_use[a]];
        }
    }
    scattered(u->gain, v->noise, r, k, u->noise);
    scattered(u->gain, v->timing, r, k, u->timing);
    for (Py_ssize_t j = 0; j < t; j++)
        for (Py_ssize_t l = 0; l < t; l++) {
            const double *errors = v->errors + (j * t + l) * r * r;
            memset(turned, 0, (size_t)(r * k) * sizeof(double));
            for (Py_ssize_t a = 0; a < r; a++)
                for (Py_ssize_t i = 0; i < k; i++) {
                    double sum = 0;
                    for (Py_ssize_t b = 0; b < r; b++) sum += errors[a * r + b] * u->gain[i * r + b];
                    turned[a * k + i] = sum;
                }
            double *into = u->errors + (j * t + l) * k * k;
            for (Py_ssize_t i = 0; i < k; i++)
                for (Py_ssize_t m = 0; m < k; m++) {
                    double sum = 0;
                    for (Py_ssize_t a = 0; a < r; a++) sum += u->gain[i * r + a] * turned[a * k + m];
                    into[i * k + m] = sum;
                }
        }
    return 1;
}

typedef struct {
    const double *values, *usual, *last_triad;                           /* (n,r), as above, (back,3) */
    const long long *time, *last_time;                                  /* (n), (back) */
    double *unknowns, *covariance, *weights, *squares, *products, *blur; /* (n,k) (n,k,k) (n) (t,t) (t,r) (3,3) */
} Frames;

/* The unknowns of all frames; 0 if one of them needs a gain of its own. The largest square of a triad. */
static int solved(const Frames *f, const Usual *u, Py_ssize_t n, Py_ssize_t r, Py_ssize_t k, double reach, double *largest) {
    *largest = 0;
    for (Py_ssize_t frame = 0; frame < n; frame++) {
        double *x = f->unknowns + frame * k, away = 0, square = 0;
        for (Py_ssize_t i = 0; i < k; i++) {
            double sum = 0;
            for (Py_ssize_t row = 0; row < r; row++) sum += f->values[frame * r + row] * u->gain[i * r + row];
            x[i] = sum - u->expected[i];
            if (!isfinite(x[i])) return 0;
        }
        for (int i = 0; i < 3; i++) {
            away += (x[i] - u->stimulus[i]) * (x[i] - u->stimulus[i]);
            square += x[i] * x[i];
        }
        if (!(sqrt(away) <= reach)) return 0;
        *largest = fmax(*largest, square);
    }
    return 1;
}

/* Covariances of the frames, their weights and the sum of the squares of the change. */
static double spread(const Frames *f, const Usual *u, Py_ssize_t n, Py_ssize_t k, Py_ssize_t t, Py_ssize_t back, double worst) {
    double total = 0;
    for (Py_ssize_t frame = 0; frame < n; frame++) {
        const double *x = f->unknowns + frame * k;
        double terms[TERMS] = {1, x[0], x[1], x[2]}, change = 0, *covariance = f->covariance + frame * k * k;
        if (worst > 0) {
            const double *then = frame < back ? f->last_triad + 3 * frame : f->unknowns + (frame - back) * k;
            long long passed = f->time[frame] - (frame < back ? f->last_time[frame] : f->time[frame - back]);
            double seconds = fmax((double)passed * 1e-9, 1e-9);
            for (int i = 0; i < 3; i++) change += (x[i] - then[i]) * (x[i] - then[i]);
            change = isnan(change) ? 0 : change / (seconds * seconds);
            total += change;
        }
        f->weights[frame] = 1 / (1 + worst * worst * change);
        for (Py_ssize_t i = 0; i < k * k; i++) covariance[i] = u->noise[i] + change * u->timing[i];
        for (Py_ssize_t j = 0; j < t; j++)
            for (Py_ssize_t l = 0; l < t; l++) {
                double product = terms[j] * terms[l];
                const double *errors = u->errors + (j * t + l) * k * k;
                for (Py_ssize_t i = 0; i < k * k; i++) covariance[i] += product * errors[i];
            }
    }
    return total;
}

static void gather(const Frames *f, Py_ssize_t n, Py_ssize_t r, Py_ssize_t k, Py_ssize_t t) {
    for (Py_ssize_t frame = 0; frame < n; frame++) {
        const double *x = f->unknowns + frame * k, *values = f->values + frame * r, weight = f->weights[frame];
        double terms[TERMS] = {1, x[0], x[1], x[2]};
        for (Py_ssize_t j = 0; j < t; j++) {
            double weighed = weight * terms[j];
            for (Py_ssize_t l = 0; l < t; l++) f->squares[j * t + l] += weighed * terms[l];
            for (Py_ssize_t row = 0; row < r; row++) f->products[j * r + row] += weighed * values[row];
        }
        if (t > 1)
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) f->blur[3 * i + j] += weight * f->covariance[frame * k * k + i * k + j];
    }
}

static int are_sizes(Py_ssize_t r, Py_ssize_t k, Py_ssize_t t) {
    return r >= 3 && r <= MOST_ROWS && (k == 3 || k == UNKNOWNS) && (t == 1 || t == TERMS);
}

static PyObject *begin(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t r, k, t;
    int final;
    double change, tolerance, reach = -1;
    if (!PyArg_ParseTuple(args, "O!(nnn)pdd", &PyTuple_Type, &sequence, &r, &k, &t, &final, &change, &tolerance)) return NULL;
    if (!are_sizes(r, k, t)) return PyFloat_FromDouble(-1);
    const Py_ssize_t bytes[] = {DOUBLES(r * k), DOUBLES(r), DOUBLES(r), DOUBLES(r), DOUBLES(t * t * r * r),
                                DOUBLES(r), r, DOUBLES(usual_size(r, k, t))};
    Py_buffer views[8];
    Py_ssize_t held = hold(sequence, views, 8, bytes, 7);
    double *room = NULL;
    Py_ssize_t *in_use = NULL;
    if (!PyErr_Occurred()) {
        View v = {views[0].buf, views[1].buf, views[2].buf, views[3].buf, views[4].buf, views[5].buf, views[6].buf};
        Usual u = usual_of(views[7].buf, r, k, t);
        room = PyMem_Malloc((size_t)(2 * r * k + r * r + k * r) * sizeof(double));
        in_use = PyMem_Malloc((size_t)r * sizeof(Py_ssize_t));
        if (room == NULL || in_use == NULL)
            PyErr_NoMemory();
        else if (prepare(&v, &u, r, k, t, final, change, room, in_use))
            reach = t == 1 || final ? HUGE_VAL : reach_of(&v, &u, r, t, tolerance);
    }
    PyMem_Free(room);
    PyMem_Free(in_use);
    while (held > 0) PyBuffer_Release(&views[--held]);
    return PyErr_Occurred() ? NULL : PyFloat_FromDouble(reach);
}

static PyObject *frames(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, r, k, t, back;
    double reach, worst, fair, largest = 0, total = 0;
    int teaches, done = 0;
    if (!PyArg_ParseTuple(args, "O!(nnnnn)pddd", &PyTuple_Type, &sequence, &n, &r, &k, &t, &back, &teaches, &reach, &worst,
                          &fair))
        return NULL;
    if (!are_sizes(r, k, t) || n < 0 || back < 0) return Py_BuildValue("id", 0, 0.0);
    const Py_ssize_t bytes[] = {DOUBLES(n * r), DOUBLES(usual_size(r, k, t)), DOUBLES(3 * back), DOUBLES(n), DOUBLES(back),
                                DOUBLES(n * k), DOUBLES(n * k * k), DOUBLES(n), DOUBLES(t * t), DOUBLES(t * r), DOUBLES(9)};
    Py_buffer views[11];
    Py_ssize_t held = hold(sequence, views, 11, bytes, 5);
    if (!PyErr_Occurred()) {
        Usual u = usual_of(views[1].buf, r, k, t);
        Frames f = {views[0].buf, views[1].buf, views[2].buf, views[3].buf, views[4].buf, views[5].buf,
                    views[6].buf, views[7].buf, views[8].buf, views[9].buf, views[10].buf};
        if (solved(&f, &u, n, r, k, reach, &largest)) {
            total = spread(&f, &u, n, k, t, back, worst);
            done = teaches && largest < fair ? 2 : 1;
            if (done == 2) gather(&f, n, r, k, t);
        }
    }
    while (held > 0) PyBuffer_Release(&views[--held]);
    return PyErr_Occurred() ? NULL : Py_BuildValue("id", done, total);
}

static PyMethodDef methods[] = {
    {"begin", begin, METH_VARARGS,
     "begin(arrays, sizes, final, change, tolerance): the usual gain of a segment, into the last array; how far it serves."},
    {"frames", frames, METH_VARARGS,
     "frames(arrays, sizes, teaches, reach, worst, fair): solve frames by the usual gain and learn from them; 0 not done,"
     " 1 solved, 2 learnt from too, and the sum of the squares of the change."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_segments", "Segments of frames that are alike.",
                                        0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__segments(void) { return PyModuleDef_Init(&definition); }

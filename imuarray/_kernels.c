/* Recursions over rows or segments, of which each needs the one before, so that NumPy can't take all of them at once.

   `tridiagonal` serves the recursions of `imuarray.recursion`, `drift` the likelihood of `imuarray.calibrate.drift`,
   `track` the filter of `imuarray.fuse.techniques.ranges`, and `non_negative` the fits of
   `imuarray.characterise.allan_fit`, of which a log needs a thousand. The names are those of the Python code, where every
   step is explained, and which does the same to rounding. */

#include "_buffers.h"

#include <math.h>
#include <string.h>

#define MOST 16
#define PRODUCTS 32 /* variances that are multiplied before the logarithm is taken of their product */

/* x[i] = alone[i] + before[i] x[i - 1] + after[i] x[i + 1] of every line of alone (c, k), which becomes x: elimination
   from the first row to the last and back; `share` (k) and `scale` (k) are room. */
static void tridiagonal_rows(const double *before, const double *after, double *alone, double *share, double *scale,
                             Py_ssize_t c, Py_ssize_t k) {
    scale[0] = 1;
    share[0] = after[0];
    for (Py_ssize_t i = 1; i < k; i++) {
        scale[i] = 1 / (1 - before[i] * share[i - 1]);
        share[i] = after[i] * scale[i];
    }
    for (Py_ssize_t line = 0; line < c; line++) {
        double *x = alone + line * k;
        for (Py_ssize_t i = 1; i < k; i++) x[i] = (x[i] + before[i] * x[i - 1]) * scale[i];
        for (Py_ssize_t i = k - 2; i >= 0; i--) x[i] += share[i] * x[i + 1];
    }
}

static PyObject *tridiagonal(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t c, k;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &c, &k)) return NULL;
    if (c < 1 || k < 1) {
        PyErr_SetString(PyExc_ValueError, "no rows");
        return NULL;
    }
    const Py_ssize_t bytes[] = {DOUBLES(k), DOUBLES(k), DOUBLES(c * k), DOUBLES(k), DOUBLES(k)};
    Py_buffer views[5];
    Py_ssize_t held = hold(sequence, views, 5, bytes, 2);
    if (!PyErr_Occurred())
        tridiagonal_rows(views[0].buf, views[1].buf, views[2].buf, views[3].buf, views[4].buf, c, k);
    return released(views, held);
}

typedef struct {
    const double *means, *kept, *shared, *noise; /* (n,a) (n,t) (t,u,s) (t,u,s) */
    double *values, *ones, *mixed, *logs;        /* (t,u,a) (t,u,s) (t,u,a) (t,u,s) */
} Drift;

#define POINTS 4 /* of the grid, which a processor takes at once */
#define EACH for (int p = 0; p < POINTS; p++)

/* Code for processors with AVX2 beside the code for all others, chosen when the module is loaded; both give the same
   bits. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__)
#define CLONES __attribute__((target_clones("avx2", "default")))
#else
#define CLONES
#endif

/* The filter at some points of one time constant, for the axes from `first` on to `last`, whose covariances are the same;
   `at` are the points' places in arrays (t, u, s), `points` their numbers. Fewer than POINTS repeat the last one. */
CLONES static void drift_points(const Drift *d, Py_ssize_t n, Py_ssize_t a, Py_ssize_t t, Py_ssize_t time,
                                const Py_ssize_t *at, const Py_ssize_t *points, Py_ssize_t first, Py_ssize_t last) {
    double shared[POINTS], noise[POINTS], variance[POINTS], level[POINTS] = {0}, ones[POINTS] = {0}, logs[POINTS] = {0};
    double product[POINTS], state[MOST][POINTS] = {{0}}, values[MOST][POINTS] = {{0}}, mixed[MOST][POINTS] = {{0}};
    EACH {
        shared[p] = variance[p] = d->shared[at[p]];
        noise[p] = d->noise[at[p]];
        product[p] = 1;
    }
    for (Py_ssize_t i = 0; i < n; i++) {
        const double kept = d->kept[i * t + time], square = kept * kept;
        double inverse[POINTS], unit[POINTS], gain[POINTS];
        EACH {
            const double spread = variance[p] + noise[p];
            inverse[p] = 1 / spread;
            unit[p] = 1 - level[p];
            gain[p] = variance[p] * inverse[p];
            ones[p] += unit[p] * unit[p] * inverse[p];
            product[p] *= spread;
        }
        if ((i + 1) % PRODUCTS == 0) EACH {
            logs[p] += log(product[p]);
            product[p] = 1;
        }
        for (Py_ssize_t axis = first; axis < last; axis++) {
            const double mean = d->means[i * a + axis];
            double *own = state[axis], *sums = values[axis], *both = mixed[axis];
            EACH {
                const double innovation = mean - own[p];
                sums[p] += innovation * innovation * inverse[p];
                both[p] += innovation * unit[p] * inverse[p];
                own[p] = kept * (own[p] + gain[p] * innovation);
            }
        }
        EACH {
            level[p] = kept * (level[p] + gain[p] * unit[p]);
            variance[p] = square * gain[p] * noise[p] + (1 - square) * shared[p];
        }
    }
    EACH {
        d->ones[at[p]] = ones[p];
        d->logs[at[p]] = logs[p] + log(product[p]);
        for (Py_ssize_t axis = first; axis < last; axis++) {
            d->values[points[p] * a + axis] = values[axis][p];
            d->mixed[points[p] * a + axis] = mixed[axis][p];
        }
    }
}

static PyObject *drift(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, a, t, u, s;
    if (!PyArg_ParseTuple(args, "O!(nnnnn)", &PyTuple_Type, &sequence, &n, &a, &t, &u, &s)) return NULL;
    if (n < 0 || a < 1 || a > MOST || t < 1 || u < 1 || (s != 1 && s != a)) {
        PyErr_SetString(PyExc_ValueError, "other sizes are required");
        return NULL;
    }
    const Py_ssize_t bytes[] = {DOUBLES(n * a),     DOUBLES(n * t),     DOUBLES(t * u * s), DOUBLES(t * u * s),
                                DOUBLES(t * u * a), DOUBLES(t * u * s), DOUBLES(t * u * a), DOUBLES(t * u * s)};
    Py_buffer views[8];
    Py_ssize_t held = hold(sequence, views, 8, bytes, 4);
    if (!PyErr_Occurred()) {
        Drift d = {views[0].buf, views[1].buf, views[2].buf, views[3].buf,
                   views[4].buf, views[5].buf, views[6].buf, views[7].buf};
        for (Py_ssize_t time = 0; time < t; time++)
            for (Py_ssize_t ratio = 0; ratio < u; ratio += POINTS)
                for (Py_ssize_t own = 0; own < s; own++) {
                    Py_ssize_t points[POINTS], at[POINTS];
                    EACH {
                        points[p] = time * u + (ratio + p < u ? ratio + p : u - 1);
                        at[p] = points[p] * s + own;
                    }
                    drift_points(&d, n, a, t, time, at, points, own, s == 1 ? a : own + 1);
                }
    }
    return released(views, held);
}

/* left (3, 3) @ result = right (3, 3) by elimination with the largest pivot, into right; left is used up. 0 if it is
   singular. */
static int solve(double left[3][3], double right[3][3]) {
    for (int column = 0; column < 3; column++) {
        int best = column;
        for (int row = column + 1; row < 3; row++)
            if (fabs(left[row][column]) > fabs(left[best][column])) best = row;
        if (!(fabs(left[best][column]) > 0)) return 0;
        for (int i = 0; i < 3 && best != column; i++) {
            double other = left[column][i];
            left[column][i] = left[best][i], left[best][i] = other;
            other = right[column][i];
            right[column][i] = right[best][i], right[best][i] = other;
        }
        for (int row = column + 1; row < 3; row++) {
            const double factor = left[row][column] / left[column][column];
            for (int i = column; i < 3; i++) left[row][i] -= factor * left[column][i];
            for (int i = 0; i < 3; i++) right[row][i] -= factor * right[column][i];
        }
    }
    for (int row = 2; row >= 0; row--)
        for (int i = 0; i < 3; i++) {
            for (int j = row + 1; j < 3; j++) right[row][i] -= left[row][j] * right[j][i];
            right[row][i] /= left[row][row];
        }
    return 1;
}

static void multiply(double a[3][3], double b[3][3], double into[3][3]) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) into[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
}

/* a (3, 3) @ b (3, 3) @ a', into c, to which it is added. */
static void add_around(double a[3][3], double b[3][3], double c[3][3]) {
    double half[3][3];
    multiply(a, b, half);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) c[i][j] += half[i][0] * a[j][0] + half[i][1] * a[j][1] + half[i][2] * a[j][2];
}

typedef struct {
    const double *products, *residuals, *walks, *through, *turned, *weights; /* (k,m,3,3) (k,m,3) (k,m,3) (m,m) (m,m) (m) */
    const char *moved;                                                       /* (k,m) */
    double *differences, *covariances;                                       /* (k+1,m,3) (k+1,m,3,3) */
} Track;

/* One axis takes in a segment: `shift` (3), what the blend of those present differs from that of all. 0 if not solvable. */
static int learn(const Track *t, Py_ssize_t place, const double *shift, double weight, double *difference, double *covariance) {
    double left[3][3], gain[3][3], information[3][3], kept[3][3], before[3][3], after[3][3] = {{0}}, residual[3];
    memcpy(before, covariance, sizeof before);
    memcpy(gain, covariance, sizeof gain);
    for (int i = 0; i < 3; i++) {
        const double *row = t->products + (place * 3 + i) * 3;
        residual[i] = (t->residuals[place * 3 + i] + row[0] * shift[0] + row[1] * shift[1] + row[2] * shift[2]) * weight;
        for (int j = 0; j < 3; j++) information[i][j] = row[j] * weight;
    }
    multiply(before, information, left);
    for (int i = 0; i < 3; i++) left[i][i] += 1;
    if (!solve(left, gain)) return 0;
    if (!t->moved[place]) memset(gain[1], 0, 2 * sizeof gain[1]);
    multiply(gain, information, kept);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) kept[i][j] = (i == j) - kept[i][j];
    add_around(kept, before, after);
    add_around(gain, information, after);
    for (int i = 0; i < 3; i++) {
        difference[i] += gain[i][0] * residual[0] + gain[i][1] * residual[1] + gain[i][2] * residual[2];
        for (int j = 0; j < 3; j++) covariance[3 * i + j] = (after[i][j] + after[j][i]) / 2;
    }
    return 1;
}

static int track_segments(const Track *t, Py_ssize_t k, Py_ssize_t m, double *shifts) {
    for (Py_ssize_t segment = 0; segment < k; segment++) {
        const double *old = t->differences + segment * m * 3, *products = t->products + segment * m * 9;
        double *differences = t->differences + (segment + 1) * m * 3;
        double *covariances = t->covariances + (segment + 1) * m * 9;
        memcpy(differences, old, (size_t)DOUBLES(m * 3));
        memcpy(covariances, covariances - m * 9, (size_t)DOUBLES(m * 9));
        for (Py_ssize_t i = 0; i < m * 3; i++) covariances[i * 3 + i % 3] += t->walks[segment * m * 3 + i];
        int tells = 0;
        for (Py_ssize_t i = 0; i < m * 9 && !tells; i++) tells = products[i] != 0;
        if (!tells) continue;
        for (Py_ssize_t axis = 0; axis < m; axis++)
            for (int i = 0; i < 3; i++) {
                const double *row = (i ? t->turned : t->through) + axis * m;
                double level = 0;
                for (Py_ssize_t other = 0; other < m; other++) level += row[other] * old[other * 3 + i];
                shifts[axis * 3 + i] = level - old[axis * 3 + i];
            }
        for (Py_ssize_t axis = 0; axis < m; axis++)
            if (!learn(t, segment * m + axis, shifts + axis * 3, t->weights[axis], differences + axis * 3,
                       covariances + axis * 9))
                return 0;
    }
    return 1;
}

static PyObject *track(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t k, m;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &k, &m)) return NULL;
    if (k < 0 || m < 1) {
        PyErr_SetString(PyExc_ValueError, "other sizes are required");
        return NULL;
    }
    const Py_ssize_t bytes[] = {DOUBLES(k * m * 9), DOUBLES(k * m * 3), DOUBLES(k * m * 3),       DOUBLES(m * m),
                                DOUBLES(m * m),     DOUBLES(m),         k * m,                    DOUBLES((k + 1) * m * 3),
                                DOUBLES((k + 1) * m * 9)};
    Py_buffer views[9];
    Py_ssize_t held = hold(sequence, views, 9, bytes, 7);
    if (!PyErr_Occurred()) {
        Track t = {views[0].buf, views[1].buf, views[2].buf, views[3].buf, views[4].buf,
                   views[5].buf, views[6].buf, views[7].buf, views[8].buf};
        double *shifts = PyMem_Malloc((size_t)DOUBLES(m * 3));
        if (shifts == NULL)
            PyErr_NoMemory();
        else if (!track_segments(&t, k, m, shifts))
            PyErr_SetString(PyExc_ArithmeticError, "a covariance is not positive");
        PyMem_Free(shifts);
    }
    return released(views, held);
}

/* Least squares x of design (n, k) @ x = target (n) with the columns that are `free`, the others 0, by Householder's
   reflections; `room` holds n * (k + 1). 0 if columns depend on each other. */
static int least_squares(const double *design, const double *target, const int *free, Py_ssize_t n, Py_ssize_t k, double *x,
                         double *room) {
    Py_ssize_t columns[MOST], count = 0;
    for (Py_ssize_t column = 0; column < k; column++) {
        x[column] = 0;
        if (free[column]) columns[count++] = column;
    }
    if (count > n) return 0;
    double *right = room + count * n;
    for (Py_ssize_t column = 0; column < count; column++)
        for (Py_ssize_t row = 0; row < n; row++) room[column * n + row] = design[row * k + columns[column]];
    memcpy(right, target, (size_t)DOUBLES(n));
    double diagonal[MOST];
    for (Py_ssize_t column = 0; column < count; column++) {
        double *own = room + column * n, length = 0;
        for (Py_ssize_t row = column; row < n; row++) length += own[row] * own[row];
        length = sqrt(length);
        if (!(length > 0)) return 0;
        diagonal[column] = own[column] > 0 ? -length : length;
        own[column] -= diagonal[column];
        const double square = -diagonal[column] * own[column]; /* half of that of the reflection's vector */
        for (Py_ssize_t other = column + 1; other <= count; other++) {
            double *line = other == count ? right : room + other * n, product = 0;
            for (Py_ssize_t row = column; row < n; row++) product += own[row] * line[row];
            product /= square;
            for (Py_ssize_t row = column; row < n; row++) line[row] -= product * own[row];
        }
    }
    for (Py_ssize_t column = count - 1; column >= 0; column--) {
        double value = right[column];
        for (Py_ssize_t other = column + 1; other < count; other++) value -= room[other * n + column] * x[columns[other]];
        x[columns[column]] = value / diagonal[column];
    }
    return 1;
}

/* The column that is not free and along which the residual falls fastest, -1 if it falls along none. */
static Py_ssize_t steepest(const double *design, const double *target, const double *x, const int *free, Py_ssize_t n,
                           Py_ssize_t k, double tolerance) {
    double slopes[MOST] = {0};
    for (Py_ssize_t row = 0; row < n; row++) {
        double rest = target[row];
        for (Py_ssize_t column = 0; column < k; column++) rest -= design[row * k + column] * x[column];
        for (Py_ssize_t column = 0; column < k; column++) slopes[column] += design[row * k + column] * rest;
    }
    Py_ssize_t best = -1;
    for (Py_ssize_t column = 0; column < k; column++)
        if (!free[column] && slopes[column] > tolerance && (best < 0 || slopes[column] > slopes[best])) best = column;
    return best;
}

/* The active set method of Lawson and Hanson ("Solving Least Squares Problems", 1974, chapter 23): x >= 0. 0 if it does
   not end. */
static int solve_non_negative(const double *design, const double *target, Py_ssize_t n, Py_ssize_t k, double *x, double *room) {
    int free[MOST] = {0};
    double best[MOST], largest = 0;
    for (Py_ssize_t column = 0; column < k; column++) {
        double sum = 0;
        for (Py_ssize_t row = 0; row < n; row++) sum += fabs(design[row * k + column]);
        largest = sum > largest ? sum : largest;
        x[column] = 0;
    }
    const double tolerance = 10 * (double)(n > k ? n : k) * 2.220446049250313e-16 * largest;
    for (Py_ssize_t turn = 0; turn <= 3 * k; turn++) {
        Py_ssize_t next = steepest(design, target, x, free, n, k, tolerance);
        if (next < 0) return 1;
        free[next] = 1;
        for (;;) {
            if (!least_squares(design, target, free, n, k, best, room)) return 0;
            double way = 1;
            for (Py_ssize_t column = 0; column < k; column++)
                if (free[column] && best[column] < 0 && x[column] / (x[column] - best[column]) < way)
                    way = x[column] / (x[column] - best[column]);
            if (way == 1) break;
            for (Py_ssize_t column = 0; column < k; column++) {
                x[column] += way * (best[column] - x[column]);
                if (x[column] <= tolerance) free[column] = 0;
            }
        }
        memcpy(x, best, sizeof(double) * (size_t)k);
    }
    return 0;
}

static PyObject *non_negative(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, k;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &n, &k)) return NULL;
    if (n < 1 || k < 1 || k > MOST) {
        PyErr_SetString(PyExc_ValueError, "other sizes are required");
        return NULL;
    }
    const Py_ssize_t bytes[] = {DOUBLES(n * k), DOUBLES(n), DOUBLES(k), DOUBLES(n * (k + 1))};
    Py_buffer views[4];
    Py_ssize_t held = hold(sequence, views, 4, bytes, 2);
    int done = 0;
    if (!PyErr_Occurred()) done = solve_non_negative(views[0].buf, views[1].buf, n, k, views[2].buf, views[3].buf);
    while (held > 0) PyBuffer_Release(&views[--held]);
    return PyErr_Occurred() ? NULL : PyBool_FromLong(done);
}

static PyMethodDef methods[] = {
    {"non_negative", non_negative, METH_VARARGS,
     "non_negative(arrays, sizes): least squares without negative coefficients, and whether it ended."},
    {"tridiagonal", tridiagonal, METH_VARARGS, "tridiagonal(arrays, sizes): solve lines of equations between neighbours."},
    {"drift", drift, METH_VARARGS, "drift(arrays, sizes): filter the means of a stretch at every point of a grid."},
    {"track", track, METH_VARARGS, "track(arrays, sizes): track the differences of axes over consecutive segments."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernels", "Recursions.", 0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernels(void) { return PyModuleDef_Init(&definition); }

/* The steps of the filter and of the smoother of slow errors, as `states.py` explains them and does them with NumPy.

   A step is some hundred thousand multiplications of matrices that fit into a processor's second cache. NumPy's products
   don't know which matrices are symmetric or sparse, and every call costs as much as ten thousand multiplications.

   Sizes: n states, p measurements, r rows, t terms. */

#include "../../_buffers.h"

#include <math.h>
#include <string.h>

#define TALL 4
#define WIDE 8
#define MOST_STATES 4096
#define MOST_ROWS 4096

/* A type of four numbers at once, where the compiler has one and the processor enough registers: on x86 only those with
   fused multiplication and addition, on others always. */
#define HALF 4
#if defined(__GNUC__)
#define INLINED static inline __attribute__((always_inline)) /* into the code for each kind of processor */
#define HAVE_QUADS 1
typedef double Quad __attribute__((vector_size(32)));
#define QUAD_OF(number) ((Quad){number, number, number, number})
#else
#define INLINED static inline
#define HAVE_QUADS 0
#endif
#if defined(__GNUC__) && defined(__x86_64__)
#define FUSED __attribute__((target("fma")))
#define IS_FUSED __builtin_cpu_supports("fma")
#else
#define FUSED
#define IS_FUSED HAVE_QUADS
#endif

/* A matrix by its first entry and the distances of entries that are next to each other in a column and in a row. */
typedef struct {
    const double *at;
    Py_ssize_t down, across;
} Matrix;

/* The product of TALL rows, whose numbers are `across` apart, with a strip of WIDE columns, whose rows are `step` apart. */
INLINED void multiply_tile(double tile[TALL][WIDE], const double *const *of, Py_ssize_t across, const double *strip,
                           Py_ssize_t step, Py_ssize_t depth, int quads) {
#if HAVE_QUADS
    if (quads) {
        const double *a = of[0], *b = of[1], *e = of[2], *f = of[3];
        Quad a0 = {0}, a1 = {0}, b0 = {0}, b1 = {0}, e0 = {0}, e1 = {0}, f0 = {0}, f1 = {0}, low, high, factor;
        for (Py_ssize_t k = 0; k < depth; k++, strip += step, a += across, b += across, e += across, f += across) {
            memcpy(&low, strip, sizeof(Quad));
            memcpy(&high, strip + HALF, sizeof(Quad));
            factor = QUAD_OF(*a), a0 += factor * low, a1 += factor * high;
            factor = QUAD_OF(*b), b0 += factor * low, b1 += factor * high;
            factor = QUAD_OF(*e), e0 += factor * low, e1 += factor * high;
            factor = QUAD_OF(*f), f0 += factor * low, f1 += factor * high;
        }
        memcpy(tile[0], &a0, sizeof(Quad)), memcpy(tile[0] + HALF, &a1, sizeof(Quad));
        memcpy(tile[1], &b0, sizeof(Quad)), memcpy(tile[1] + HALF, &b1, sizeof(Quad));
        memcpy(tile[2], &e0, sizeof(Quad)), memcpy(tile[2] + HALF, &e1, sizeof(Quad));
        memcpy(tile[3], &f0, sizeof(Quad)), memcpy(tile[3] + HALF, &f1, sizeof(Quad));
        return;
    }
#endif
    (void)quads;
    memset(tile, 0, TALL * WIDE * sizeof(double));
    for (Py_ssize_t k = 0; k < depth; k++, strip += step)
        for (int i = 0; i < TALL; i++)
            for (int j = 0; j < WIDE; j++) tile[i][j] += of[i][k * across] * strip[j];
}

/* Rows, depth and columns of a product, and whether only what is at and above the diagonal of tiles is required. */
typedef struct {
    Py_ssize_t rows, depth, columns;
    int upper;
} Shape;

/* c (rows, columns) += sign left (rows, depth) @ right (depth, columns), c and right without gaps. Tiles at the ends overlap
   others or repeat a row, and only what is new of them is added. */
INLINED void add_tiles(double *c, Matrix left, const double *right, Shape s, double sign, int quads) {
    for (Py_ssize_t j = 0; j < s.columns; j += WIDE) {
        Py_ssize_t first = j + WIDE <= s.columns ? j : s.columns - WIDE;
        for (Py_ssize_t i = 0; i < s.rows && !(s.upper && j + WIDE <= i); i += TALL) {
            const double *of[TALL];
            double tile[TALL][WIDE];
            for (int row = 0; row < TALL; row++)
                of[row] = left.at + (i + row < s.rows ? i + row : s.rows - 1) * left.down;
            multiply_tile(tile, of, left.across, right + first, s.columns, s.depth, quads);
            for (Py_ssize_t row = 0; row < TALL && i + row < s.rows; row++) {
                double *to = c + (i + row) * s.columns + first;
                if (first == j)
                    for (int column = 0; column < WIDE; column++) to[column] += sign * tile[row][column];
                else
                    for (Py_ssize_t column = j - first; column < WIDE; column++) to[column] += sign * tile[row][column];
            }
        }
    }
}

FUSED static void add_fused(double *c, Matrix left, const double *right, Shape s, double sign) {
    add_tiles(c, left, right, s, sign, HAVE_QUADS);
}

static void add_plain(double *c, Matrix left, const double *right, Shape s, double sign) {
    add_tiles(c, left, right, s, sign, 0);
}

static void add_product(double *c, Matrix left, const double *right, Shape s, double sign) {
    if (s.columns >= WIDE && IS_FUSED) {
        add_fused(c, left, right, s, sign);
    } else if (s.columns >= WIDE) {
        add_plain(c, left, right, s, sign);
    } else {
        for (Py_ssize_t i = 0; i < s.rows; i++)
            for (Py_ssize_t k = 0; k < s.depth; k++) {
                double factor = sign * left.at[i * left.down + k * left.across];
                for (Py_ssize_t j = 0; j < s.columns; j++) c[i * s.columns + j] += factor * right[k * s.columns + j];
            }
    }
}

/* Copies the upper part to the lower one, in squares that stay in the first cache. */
static void copy_upper(double *square, Py_ssize_t size) {
    for (Py_ssize_t top = 0; top < size; top += WIDE)
        for (Py_ssize_t edge = 0; edge <= top; edge += WIDE)
            for (Py_ssize_t i = top; i < top + WIDE && i < size; i++)
                for (Py_ssize_t j = edge; j < edge + WIDE && j < i; j++) square[i * size + j] = square[j * size + i];
}

static void transpose(double *into, const double *matrix, Py_ssize_t rows, Py_ssize_t columns) {
    for (Py_ssize_t i = 0; i < rows; i++)
        for (Py_ssize_t j = 0; j < columns; j++) into[j * rows + i] = matrix[i * columns + j];
}

/* to += factor from, of so many numbers. */
static inline void add(double *to, double factor, const double *from, Py_ssize_t count) {
    for (Py_ssize_t i = 0; i < count; i++) to[i] += factor * from[i];
}

static double dot(const double *a, const double *b, Py_ssize_t count) {
    double sum[4] = {0};
    Py_ssize_t i = 0;
    for (; i + 4 <= count; i += 4)
        for (int k = 0; k < 4; k++) sum[k] += a[i + k] * b[i + k];
    for (; i < count; i++) sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Rows with few entries: those of row i are at `starts[i]` to `starts[i + 1]`. */
typedef struct {
    const long long *starts, *columns;
    const double *entries;
} Sparse;

static int is_sparse(const Sparse *s, Py_ssize_t rows, Py_ssize_t columns, Py_ssize_t entries) {
    if (s->starts[0] != 0 || s->starts[rows] != entries) return 0;
    for (Py_ssize_t i = 0; i < rows; i++)
        if (s->starts[i] > s->starts[i + 1]) return 0;
    for (Py_ssize_t e = 0; e < entries; e++)
        if (s->columns[e] < 0 || s->columns[e] >= columns) return 0;
    return 1;
}

/* Arrays and scratch memory of a call. */
typedef struct {
    Py_buffer views[16];
    Py_ssize_t held;
    double *room;
} Call;

static int prepared(Call *call, PyObject *sequence, Py_ssize_t count, const Py_ssize_t *bytes, Py_ssize_t read,
                    Py_ssize_t doubles) {
    call->room = NULL;
    call->held = hold(sequence, call->views, count, bytes, read);
    if (PyErr_Occurred()) return 0;
    call->room = PyMem_Calloc((size_t)(doubles > 0 ? doubles : 1), sizeof(double));
    if (call->room == NULL) PyErr_NoMemory();
    return call->room != NULL;
}

static PyObject *finished(Call *call, int done) {
    PyMem_Free(call->room);
    while (call->held > 0) PyBuffer_Release(&call->views[--call->held]);
    return PyErr_Occurred() ? NULL : PyBool_FromLong(done);
}

static int are_sizes(Py_ssize_t n, Py_ssize_t p, Py_ssize_t rows) {
    return sizes_allowed(n >= 0 && n <= MOST_STATES && p >= 0 && p <= MOST_ROWS && rows >= 0 && rows <= MOST_ROWS);
}

/* Mean (n) and covariance (n, n) of n states. */
typedef struct {
    const double *mean, *covariance;
} States;

static void predict_into(double *mean, double *covariance, States before, const double *remaining, const double *added,
                         Py_ssize_t n) {
    for (Py_ssize_t i = 0; i < n; i++) {
        mean[i] = before.mean[i] * remaining[i];
        for (Py_ssize_t j = 0; j < n; j++)
            covariance[i * n + j] = before.covariance[i * n + j] * (remaining[i] * remaining[j]);
        covariance[i * n + i] += added[i];
    }
}

static PyObject *predict(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n;
    Call call;
    if (!PyArg_ParseTuple(args, "O!n", &PyTuple_Type, &sequence, &n) || !are_sizes(n, 0, 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(n), DOUBLES(n), DOUBLES(n), DOUBLES(n * n), DOUBLES(n), DOUBLES(n * n)};
    if (prepared(&call, sequence, 6, bytes, 4, 0)) {
        States before = {call.views[2].buf, call.views[3].buf};
        predict_into(call.views[4].buf, call.views[5].buf, before, call.views[0].buf, call.views[1].buf, n);
    }
    return finished(&call, 1);
}

/* The lower triangular root of a symmetric matrix, in place; 0 if it is not positive definite. */
static int rooted(double *matrix, Py_ssize_t size) {
    for (Py_ssize_t i = 0; i < size; i++)
        for (Py_ssize_t j = 0; j <= i; j++) {
            double rest = matrix[i * size + j] - dot(matrix + i * size, matrix + j * size, j);
            if (i != j) {
                matrix[i * size + j] = rest / matrix[j * size + j];
                continue;
            }
            if (!(rest > 0)) return 0;
            matrix[i * size + i] = sqrt(rest);
        }
    return 1;
}

/* rows (p, count) becomes root^-1 @ rows. */
CLONES static void whiten(double *rows, const double *root, Py_ssize_t p, Py_ssize_t count) {
    for (Py_ssize_t i = 0; i < p; i++) {
        for (Py_ssize_t j = 0; j < i; j++) add(rows + i * count, -root[i * p + j], rows + j * count, count);
        for (Py_ssize_t k = 0; k < count; k++) rows[i * count + k] /= root[i * p + i];
    }
}

/* What a step of p measurements gives: see `Innovation` in `states.py`. */
typedef struct {
    const double *whitened, *gain, *values;
} Step;

static void update_into(double *mean, double *covariance, States before, Step step, Py_ssize_t n, Py_ssize_t p) {
    memcpy(mean, before.mean, (size_t)n * sizeof(double));
    for (Py_ssize_t i = 0; i < p; i++) add(mean, step.values[i], step.gain + i * n, n);
    memcpy(covariance, before.covariance, (size_t)(n * n) * sizeof(double));
    add_product(covariance, (Matrix){step.gain, 1, n}, step.gain, (Shape){n, p, n, 1}, -1.0);
    copy_upper(covariance, n);
}

static PyObject *correct(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, p;
    int done = 0;
    Call call;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &n, &p) || !are_sizes(n, p, 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(n),     DOUBLES(n * n), DOUBLES(p * n), DOUBLES(p), DOUBLES(n),
                                DOUBLES(n * n), DOUBLES(p * n), DOUBLES(p * n), DOUBLES(p)};
    if (prepared(&call, sequence, 9, bytes, 4, p * p + n * p)) {
        const double *mean = call.views[0].buf, *covariance = call.views[1].buf, *rows = call.views[2].buf,
                     *values = call.views[3].buf;
        double *whitened = call.views[6].buf, *gain = call.views[7].buf, *innovation = call.views[8].buf;
        double *root = call.room, *turned = root + p * p;
        memset(gain, 0, (size_t)(p * n) * sizeof(double));
        add_product(gain, (Matrix){rows, n, 1}, covariance, (Shape){p, n, n, 0}, 1.0);
        transpose(turned, rows, p, n);
        add_product(root, (Matrix){gain, n, 1}, turned, (Shape){p, n, p, 0}, 1.0);
        for (Py_ssize_t i = 0; i < p; i++) root[i * p + i] += 1.0;
        done = rooted(root, p);
        if (done) {
            memcpy(whitened, rows, (size_t)(p * n) * sizeof(double));
            whiten(gain, root, p, n);
            whiten(whitened, root, p, n);
            for (Py_ssize_t i = 0; i < p; i++) innovation[i] = values[i] - dot(rows + i * n, mean, n);
            whiten(innovation, root, p, 1);
            Step step = {whitened, gain, innovation};
            update_into(call.views[4].buf, call.views[5].buf, (States){mean, covariance}, step, n, p);
        }
    }
    return finished(&call, done);
}

#define ROOM_BACK(n, p) (3 * (p) * (n) + (p) * (p))

/* The information of all later measurements before a step, `room` is scratch memory of `ROOM_BACK`. */
static void turn_back_into(double *vector_before, double *matrix_before, const double *vector, const double *matrix, Step step,
                           Py_ssize_t n, Py_ssize_t p, double *room) {
    double *across = room, *turned = across + p * n, *half = turned + p * n, *inner = half + p * n;
    memset(room, 0, (size_t)ROOM_BACK(n, p) * sizeof(double));
    memcpy(vector_before, vector, (size_t)n * sizeof(double));
    for (Py_ssize_t i = 0; i < p; i++)
        add(vector_before, -(dot(step.gain + i * n, vector, n) + step.values[i]), step.whitened + i * n, n);
    add_product(across, (Matrix){step.gain, n, 1}, matrix, (Shape){p, n, n, 0}, 1.0);
    transpose(turned, step.gain, p, n);
    add_product(inner, (Matrix){across, n, 1}, turned, (Shape){p, n, p, 0}, 0.5);
    for (Py_ssize_t i = 0; i < p; i++) inner[i * p + i] += 0.5;
    add_product(half, (Matrix){inner, p, 1}, step.whitened, (Shape){p, p, n, 0}, 1.0);
    for (Py_ssize_t i = 0; i < p * n; i++) half[i] -= across[i];
    memcpy(matrix_before, matrix, (size_t)(n * n) * sizeof(double));
    add_product(matrix_before, (Matrix){step.whitened, 1, n}, half, (Shape){n, p, n, 1}, 1.0);
    add_product(matrix_before, (Matrix){half, 1, n}, step.whitened, (Shape){n, p, n, 1}, 1.0);
    copy_upper(matrix_before, n);
}

static PyObject *turn_back(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, p;
    Call call;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &n, &p) || !are_sizes(n, p, 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(n),     DOUBLES(n * n), DOUBLES(p * n), DOUBLES(p * n),
                                DOUBLES(p),     DOUBLES(n),     DOUBLES(n * n)};
    if (prepared(&call, sequence, 7, bytes, 5, ROOM_BACK(n, p))) {
        Step step = {call.views[2].buf, call.views[3].buf, call.views[4].buf};
        turn_back_into(call.views[5].buf, call.views[6].buf, call.views[0].buf, call.views[1].buf, step, n, p, call.room);
    }
    return finished(&call, 1);
}

static double sparse_dot(const Sparse *s, Py_ssize_t row, const double *values) {
    double sum = 0;
    for (long long e = s->starts[row]; e < s->starts[row + 1]; e++) sum += s->entries[e] * values[s->columns[e]];
    return sum;
}

static PyObject *effect(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, t, r, count;
    int done = 0;
    Call call;
    if (!PyArg_ParseTuple(args, "O!(nnnn)", &PyTuple_Type, &sequence, &n, &t, &r, &count) || !are_sizes(n, t, r)) return NULL;
    Py_ssize_t rows = t * r;
    if (!are_sizes(n, count, rows)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(n), DOUBLES(n * n), DOUBLES(rows + 1), DOUBLES(count), DOUBLES(count),
                                DOUBLES(rows), DOUBLES(rows * rows)};
    if (prepared(&call, sequence, 7, bytes, 5, n)) {
        const double *mean = call.views[0].buf, *covariance = call.views[1].buf;
        Sparse s = {call.views[2].buf, call.views[3].buf, call.views[4].buf};
        double *effects = call.views[5].buf, *errors = call.views[6].buf, *cross = call.room;
        done = is_sparse(&s, rows, n, count);
        for (Py_ssize_t a = 0; done && a < rows; a++) {
            effects[a] = sparse_dot(&s, a, mean);
            memset(cross, 0, (size_t)n * sizeof(double));
            for (long long e = s.starts[a]; e < s.starts[a + 1]; e++)
                add(cross, s.entries[e], covariance + s.columns[e] * n, n);
            for (Py_ssize_t b = 0; b <= a; b++) {
                Py_ssize_t j = a / r, l = b / r, down = a % r, along = b % r;
                double product = sparse_dot(&s, b, cross);
                errors[((j * t + l) * r + down) * r + along] = errors[((l * t + j) * r + along) * r + down] = product;
            }
        }
    }
    return finished(&call, done);
}

#define ROOM_DRIFTS(n, r, rows) (2 * (r) * (n) + ((n) + (r)) * ((rows) + (r)))

/* The part of the effect on r rows of t r terms that is due to drifting states, `room` is scratch memory of `ROOM_DRIFTS`. */
static void drifts_into(double *moved, double *shared, States states, const double *vector, const double *matrix,
                        const char *drifting, Sparse s, Py_ssize_t n, Py_ssize_t r, Py_ssize_t rows, double *room) {
    Py_ssize_t wide = rows + r;
    double *cross = room, *later = cross + r * n, *response = later + r * n, *effects = response + n * wide;
    memset(room, 0, (size_t)ROOM_DRIFTS(n, r, rows) * sizeof(double));
    for (Py_ssize_t a = 0; a < r; a++) {
        moved[a] = 0;
        for (long long e = s.starts[a]; e < s.starts[a + 1]; e++)
            if (drifting[s.columns[e]]) {
                moved[a] += s.entries[e] * states.mean[s.columns[e]];
                add(cross + a * n, s.entries[e], states.covariance + s.columns[e] * n, n);
            }
        moved[a] -= dot(cross + a * n, vector, n);
    }
    add_product(later, (Matrix){cross, n, 1}, matrix, (Shape){r, n, n, 0}, 1.0);
    for (Py_ssize_t x = 0; x < n; x++)
        for (Py_ssize_t b = 0; b < rows; b++)
            for (long long e = s.starts[b]; e < s.starts[b + 1]; e++) {
                double product = s.entries[e] * states.covariance[x * n + s.columns[e]];
                response[x * wide + b] += product;
                if (b < r && !drifting[s.columns[e]]) response[x * wide + rows + b] += product;
            }
    add_product(effects, (Matrix){later, n, 1}, response, (Shape){r, n, wide, 0}, -1.0);
    for (Py_ssize_t a = 0; a < r; a++)
        for (Py_ssize_t b = 0; b < rows; b++)
            for (long long e = s.starts[b]; e < s.starts[b + 1]; e++) {
                double product = s.entries[e] * cross[a * n + s.columns[e]];
                effects[a * wide + b] += product;
                if (b < r && !drifting[s.columns[e]]) effects[a * wide + rows + b] += product;
            }
    for (Py_ssize_t a = 0; a < r; a++)
        for (Py_ssize_t b = 0; b < rows; b++)
            shared[a * rows + b] = effects[a * wide + b] + (b < r ? effects[b * wide + rows + a] : 0.0);
}

static PyObject *drifts(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, t, r, count;
    int done = 0;
    Call call;
    if (!PyArg_ParseTuple(args, "O!(nnnn)", &PyTuple_Type, &sequence, &n, &t, &r, &count) || !are_sizes(n, t, r)) return NULL;
    Py_ssize_t rows = t * r;
    if (!are_sizes(n, count, rows)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(n),     DOUBLES(n * n),   DOUBLES(n),     DOUBLES(n * n), n,
                                DOUBLES(rows + 1), DOUBLES(count), DOUBLES(count), DOUBLES(r),     DOUBLES(r * rows)};
    if (prepared(&call, sequence, 10, bytes, 8, ROOM_DRIFTS(n, r, rows))) {
        Sparse s = {call.views[5].buf, call.views[6].buf, call.views[7].buf};
        States states = {call.views[0].buf, call.views[1].buf};
        done = is_sparse(&s, rows, n, count);
        if (done)
            drifts_into(call.views[8].buf, call.views[9].buf, states, call.views[2].buf, call.views[3].buf,
                        call.views[4].buf, s, n, r, rows, call.room);
    }
    return finished(&call, done);
}

/* The sum of the numbers of measurements of k steps; -1 if one is not allowed. */
static Py_ssize_t sum_of(const long long *measurements, Py_ssize_t k) {
    Py_ssize_t sum = 0;
    for (Py_ssize_t step = 0; step < k; step++) {
        if (measurements[step] < 0 || measurements[step] > MOST_ROWS) return -1;
        sum += (Py_ssize_t)measurements[step];
    }
    return sum;
}

/* k consecutive steps of the smoother, which all have the same response: `SegmentSmoother._smooth_stride` in `filter.py`. */
static PyObject *smooth(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, t, r, count, k, all, most = 0;
    int done = 0;
    Call call;
    if (!PyArg_ParseTuple(args, "O!(nnnnnn)", &PyTuple_Type, &sequence, &n, &t, &r, &count, &k, &all)) return NULL;
    if (!are_sizes(n, t, r) || !are_sizes(n, count, t * r) || !are_sizes(k, 0, 0) || !sizes_allowed(all >= 0)) return NULL;
    Py_ssize_t rows = t * r;
    const Py_ssize_t bytes[] = {DOUBLES(n), DOUBLES(n * n), DOUBLES(k * n), DOUBLES(k * n), DOUBLES(k), DOUBLES(all * n),
                                DOUBLES(all * n), DOUBLES(all), n, DOUBLES(rows + 1), DOUBLES(count), DOUBLES(count),
                                DOUBLES(n), DOUBLES(n * n), DOUBLES(k * r), DOUBLES(k * r * rows)};
    if (prepared(&call, sequence, 16, bytes, 12, (k + 1) * (n + n * n) + ROOM_DRIFTS(n, r, rows))) {
        const double *remaining = call.views[2].buf, *added = call.views[3].buf, *whitened = call.views[5].buf,
                     *gain = call.views[6].buf, *values = call.views[7].buf;
        const long long *measurements = call.views[4].buf;
        Sparse s = {call.views[9].buf, call.views[10].buf, call.views[11].buf};
        double *vector = call.views[12].buf, *matrix = call.views[13].buf, *moved = call.views[14].buf,
               *shared = call.views[15].buf;
        double *beliefs = call.room, *mean = beliefs + k * (n + n * n), *covariance = mean + n, *room = covariance + n * n;
        done = is_sparse(&s, rows, n, count) && sum_of(measurements, k) == all;
        for (Py_ssize_t step = 0; done && step < k; step++)
            if (measurements[step] > most) most = (Py_ssize_t)measurements[step];
        double *back = done ? PyMem_Malloc((size_t)(ROOM_BACK(n, most) + 1) * sizeof(double)) : NULL;
        if (done && back == NULL) PyErr_NoMemory();
        if (back != NULL) {
            memcpy(mean, call.views[0].buf, (size_t)n * sizeof(double));
            memcpy(covariance, call.views[1].buf, (size_t)(n * n) * sizeof(double));
            Py_ssize_t before = 0; /* measurements of the steps before */
            for (Py_ssize_t step = 0; step < k; step++) {
                double *predicted = beliefs + step * (n + n * n);
                Step known = {whitened + before * n, gain + before * n, values + before};
                predict_into(predicted, predicted + n, (States){mean, covariance}, remaining + step * n, added + step * n, n);
                update_into(mean, covariance, (States){predicted, predicted + n}, known, n, (Py_ssize_t)measurements[step]);
                before += (Py_ssize_t)measurements[step];
            }
            for (Py_ssize_t step = k - 1; step >= 0; step--) {
                Py_ssize_t p = (Py_ssize_t)measurements[step];
                const double *predicted = beliefs + step * (n + n * n), *of_step = remaining + step * n;
                before -= p;
                Step known = {whitened + before * n, gain + before * n, values + before};
                turn_back_into(mean, covariance, vector, matrix, known, n, p, back); /* `mean` is not needed any more */
                drifts_into(moved + step * r, shared + step * r * rows, (States){predicted, predicted + n}, mean, covariance,
                            call.views[8].buf, s, n, r, rows, room);
                for (Py_ssize_t i = 0; i < n; i++) {
                    vector[i] = mean[i] * of_step[i];
                    for (Py_ssize_t j = 0; j < n; j++)
                        matrix[i * n + j] = covariance[i * n + j] * (of_step[i] * of_step[j]);
                }
            }
        }
        PyMem_Free(back);
    }
    return finished(&call, done);
}

#define TERMS 4
#define SWEEPS 60

/* The eigenvalues and eigenvectors (columns) of a symmetric matrix of up to four rows, by Jacobi's rotations. */
static void diagonalise(double matrix[TERMS][TERMS], double vectors[TERMS][TERMS], int size) {
    for (int i = 0; i < size; i++)
        for (int j = 0; j < size; j++) vectors[i][j] = i == j;
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        int rotated = 0;
        for (int i = 0; i < size; i++)
            for (int j = i + 1; j < size; j++) {
                double off = matrix[i][j];
                if (!(fabs(off) > 1e-17 * sqrt(fabs(matrix[i][i] * matrix[j][j])))) continue;
                double ratio = (matrix[j][j] - matrix[i][i]) / (2 * off);
                double tangent = (ratio < 0 ? -1 : 1) / (fabs(ratio) + sqrt(ratio * ratio + 1));
                double cosine = 1 / sqrt(tangent * tangent + 1), sine = tangent * cosine;
                rotated = 1;
                for (int k = 0; k < size; k++) {
                    double a = matrix[k][i], b = matrix[k][j];
                    matrix[k][i] = cosine * a - sine * b, matrix[k][j] = sine * a + cosine * b;
                }
                for (int k = 0; k < size; k++) {
                    double a = matrix[i][k], b = matrix[j][k];
                    matrix[i][k] = cosine * a - sine * b, matrix[j][k] = sine * a + cosine * b;
                    a = vectors[k][i], b = vectors[k][j];
                    vectors[k][i] = cosine * a - sine * b, vectors[k][j] = sine * a + cosine * b;
                }
                matrix[i][j] = matrix[j][i] = 0;
            }
        if (!rotated) return;
    }
}

/* The independent components of the sums of (1, stimulus): roots of their sizes and their weights (components, terms); see
   `_components` in `filter.py`. */
static int components_of(const double *squares, const double *blur, int t, double doubt, double *sizes, double *weights) {
    double matrix[TERMS][TERMS], vectors[TERMS][TERMS], spread[TERMS][TERMS], largest = 0, noise = 0;
    if (t == 1) {
        sizes[0] = sqrt(squares[0]), weights[0] = 1;
        return 1;
    }
    for (int i = 0; i < t; i++)
        for (int j = 0; j < t; j++) {
            matrix[i][j] = (squares[i * t + j] + squares[j * t + i]) / 2;
            if (i > 0 && j > 0) {
                spread[i - 1][j - 1] = (blur[(i - 1) * 3 + j - 1] + blur[(j - 1) * 3 + i - 1]) / 2;
                matrix[i][j] -= spread[i - 1][j - 1];
            }
        }
    diagonalise(matrix, vectors, t);
    double of_noise[TERMS][TERMS];
    diagonalise(spread, of_noise, t - 1);
    for (int i = 0; i < t - 1; i++) noise = i == 0 ? spread[0][0] : fmax(noise, spread[i][i]);
    noise *= doubt * sqrt(2 / squares[0]);
    for (int i = 0; i < t; i++) largest = i == 0 ? matrix[0][0] : fmax(largest, matrix[i][i]);
    int count = 0;
    for (int i = 0; i < t; i++)
        if (matrix[i][i] > fmax(noise, 1e-9 * largest)) {
            sizes[count] = sqrt(matrix[i][i]);
            for (int j = 0; j < t; j++) weights[count * t + j] = vectors[j][i];
            count++;
        }
    return count;
}

static PyObject *measure(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, t, r, count, p;
    int components = -1;
    double doubt;
    Call call;
    if (!PyArg_ParseTuple(args, "O!(nnnnn)d", &PyTuple_Type, &sequence, &n, &t, &r, &count, &p, &doubt)) return NULL;
    if ((t != 1 && t != TERMS) || r > MOST_ROWS) return PyLong_FromLong(-1);
    if (!are_sizes(n, p, r) || !are_sizes(n, t * p, t * r) || !are_sizes(n, count, 0)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(t * t), DOUBLES(t * r), DOUBLES(9), DOUBLES(p * r), DOUBLES(t * r + 1),
                                DOUBLES(count), DOUBLES(count), DOUBLES(t * p * n), DOUBLES(t * p)};
    if (prepared(&call, sequence, 9, bytes, 7, r)) {
        const double *squares = call.views[0].buf, *products = call.views[1].buf, *blur = call.views[2].buf,
                     *parity = call.views[3].buf;
        Sparse s = {call.views[4].buf, call.views[5].buf, call.views[6].buf};
        double *rows = call.views[7].buf, *values = call.views[8].buf, sizes[TERMS], weights[TERMS * TERMS];
        if (is_sparse(&s, t * r, n, count)) components = components_of(squares, blur, (int)t, doubt, sizes, weights);
        for (int c = 0; c < components; c++) {
            const double *weight = weights + c * t;
            double *of_component = rows + c * p * n, *sums = call.room;
            memset(of_component, 0, (size_t)(p * n) * sizeof(double));
            memset(sums, 0, (size_t)r * sizeof(double));
            for (Py_ssize_t j = 0; j < t; j++) add(sums, weight[j] / sizes[c], products + j * r, r);
            for (Py_ssize_t i = 0; i < p; i++) {
                values[c * p + i] = dot(parity + i * r, sums, r);
                for (Py_ssize_t j = 0; j < t; j++)
                    for (Py_ssize_t row = 0; row < r; row++) {
                        double factor = sizes[c] * weight[j] * parity[i * r + row];
                        for (long long e = s.starts[j * r + row]; e < s.starts[j * r + row + 1]; e++)
                            of_component[i * n + s.columns[e]] += factor * s.entries[e];
                    }
            }
        }
    }
    PyObject *result = finished(&call, 1);
    if (result == NULL) return NULL;
    Py_DECREF(result);
    return PyLong_FromLong(components);
}

static PyMethodDef methods[] = {
    {"predict", predict, METH_VARARGS,
     "predict(arrays, n): the states after a time, into the last two of (remaining, added, mean, covariance, mean,"
     " covariance)."},
    {"correct", correct, METH_VARARGS,
     "correct(arrays, (n, p)): the states after measurements, into the last five of (mean, covariance, rows, values, mean,"
     " covariance, whitened rows, gain, innovation); False if the covariance of the innovations is not positive definite."},
    {"turn_back", turn_back, METH_VARARGS,
     "turn_back(arrays, (n, p)): the information of all later measurements before a step, into the last two of (vector,"
     " matrix, whitened rows, gain, innovation, vector, matrix)."},
    {"measure", measure, METH_VARARGS,
     "measure(arrays, (n, t, r, entries, p), doubt): the measurements by the sums over a segment, into the last two of"
     " (squares, products, blur, parity, starts, columns, entries, rows, values); the number of components, -1 if not done."},
    {"effect", effect, METH_VARARGS,
     "effect(arrays, (n, t, r, entries)): mean and covariance of the effect on the rows, into the last two of (mean,"
     " covariance, starts, columns, entries, effect, errors); False for entries outside the matrix."},
    {"drifts", drifts, METH_VARARGS,
     "drifts(arrays, (n, t, r, entries)): the part of the effect that is due to drifting states, into the last two of (mean,"
     " covariance, vector, matrix, drifting, starts, columns, entries, effect, errors); False as `effect`."},
    {"smooth", smooth, METH_VARARGS,
     "smooth(arrays, (n, t, r, entries, k, p)): k consecutive steps of the smoother with p measurements in all, into the"
     " last four of (mean, covariance, remaining, added, measurements, whitened rows, gains, innovations, drifting, starts,"
     " columns, entries, vector, matrix, effects, errors); vector and matrix are those after the steps, then those before;"
     " False as `effect`."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_states", "Steps of the filter of slow errors.",
                                        0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__states(void) { return PyModuleDef_Init(&definition); }

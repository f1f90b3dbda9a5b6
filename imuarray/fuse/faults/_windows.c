/* Consecutive decision windows in which nothing happens, judged and learnt from one after the other.

   Does what `FaultIsolation` does with windows without a fault, with the bounds that `fast_path.py` names in place of the
   gains and energies, and what `Baseline.departed` does at intervals: a window is some thousand multiplications, which NumPy
   spreads over a hundred calls. It stops before a window that the bounds do not decide, with the state of the window before;
   the Python code then decides it.
   The names are those of the Python code (`NormalModel`, `WindowResiduals`, `WindowSeries`), where the steps are explained.

   Sizes: k windows, n frames each, m axes; STATES = 5 states of an axis, COURSES = 7 courses. */

#include "../../_buffers.h"

#include <math.h>
#include <string.h>

#define STATES 5
#define COURSES 7
#define MOST_AXES 1024
#define MOST_FRAMES 4096

/* The arrays, in the order in which Python gives them; those of `Series` are only read. */
typedef struct {
    double *own, *courses, *usual, *jitter, *moments, *changes;      /* by window */
    double *blind, *rows, *gain, *precision, *share;                 /* of the series */
    double *kept, *fresh, *variance;                                 /* of the normal model, fixed */
    double *first_state, *first_covariance, *deleted;                /* of the baseline */
    double *state, *covariance, *colour, *change, *seen, *before;    /* of the normal model, written */
    const double *masks;                                             /* (3, m): included, observable, group waiting or -1 */
} Arrays;

typedef struct {
    double limit, even, uneven, axis_gain, agrees, quiet, quietest, wander, least_share, change_windows,
        colour_windows, longest_colour, drift, sigmas;
} Limits;

typedef struct {
    double made[COURSES * MOST_AXES], seen_as[COURSES * MOST_AXES], products[COURSES * MOST_AXES];
    double means[MOST_AXES], noise[MOST_AXES], doubt[MOST_AXES], weights[MOST_AXES], shown[MOST_AXES];
    double usual[MOST_AXES * STATES];
    double *residual, *aged; /* (n, m), (m, STATES, STATES) */
    char sound[MOST_AXES];
} Work;

static int inverse(const double a[3][3], double result[3][3]) {
    double first = a[1][1] * a[2][2] - a[1][2] * a[1][2];
    double second = a[0][2] * a[1][2] - a[0][1] * a[2][2];
    double third = a[0][1] * a[1][2] - a[0][2] * a[1][1];
    double determinant = a[0][0] * first + a[0][1] * second + a[0][2] * third;
    double size = a[0][0] + a[1][1] + a[2][2];
    if (!(determinant > 1e-9 * size * size * size)) return 0;
    double mixed = a[0][1] * a[0][2] - a[0][0] * a[1][2];
    result[0][0] = first / determinant;
    result[0][1] = result[1][0] = second / determinant;
    result[0][2] = result[2][0] = third / determinant;
    result[1][1] = (a[0][0] * a[2][2] - a[0][2] * a[0][2]) / determinant;
    result[1][2] = result[2][1] = mixed / determinant;
    result[2][2] = (a[0][0] * a[1][1] - a[0][1] * a[0][1]) / determinant;
    return 1;
}

static double quadratic(const double matrix[3][3], const double *row) {
    double sum = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) sum += row[i] * matrix[i][j] * row[j];
    return sum;
}

/* Solves left @ result = right, both (5, 5), by elimination with the largest pivot; right becomes the result. */
static int solve(double left[STATES][STATES], double right[STATES][STATES]) {
    for (int column = 0; column < STATES; column++) {
        int best = column;
        for (int row = column + 1; row < STATES; row++)
            if (fabs(left[row][column]) > fabs(left[best][column])) best = row;
        if (!(fabs(left[best][column]) > 0)) return 0;
        if (best != column)
            for (int i = 0; i < STATES; i++) {
                double kept = left[column][i];
                left[column][i] = left[best][i], left[best][i] = kept;
                kept = right[column][i];
                right[column][i] = right[best][i], right[best][i] = kept;
            }
        for (int row = column + 1; row < STATES; row++) {
            double factor = left[row][column] / left[column][column];
            for (int i = column; i < STATES; i++) left[row][i] -= factor * left[column][i];
            for (int i = 0; i < STATES; i++) right[row][i] -= factor * right[column][i];
        }
    }
    for (int row = STATES - 1; row >= 0; row--)
        for (int i = 0; i < STATES; i++) {
            double sum = right[row][i];
            for (int other = row + 1; other < STATES; other++) sum -= left[row][other] * right[other][i];
            right[row][i] = sum / left[row][row];
        }
    return 1;
}

/* No sensor stands still: a bound of `Stillness`. */
static int moves(const double *changes, const double *usual, Py_ssize_t m, double quiet) {
    for (Py_ssize_t i = 0; i < m; i += 3) {
        double share = changes[i] / usual[i] + changes[i + 1] / usual[i + 1] + changes[i + 2] / usual[i + 2];
        if (!(share >= 3 * quiet)) return 0;
    }
    return 1;
}

/* The triad of the biases, in `offset`, and the mean regressors (m, STATES) of a window without it: `WindowResiduals.usual`. */
static void find_usual(const Arrays *a, Py_ssize_t index, Py_ssize_t m, double *usual, double offset[3]) {
    for (int j = 0; j < 3; j++) {
        offset[j] = 0;
        for (Py_ssize_t i = 0; i < m; i++) offset[j] += a->gain[j * m + i] * a->state[i * STATES];
    }
    memcpy(usual, a->usual + index * m * STATES, (size_t)(m * STATES) * sizeof(double));
    for (Py_ssize_t i = 0; i < m; i++)
        for (int j = 0; j < 3; j++) usual[i * STATES + 1 + j] -= offset[j];
}

/* Whether no axis has drifted too far since it settled: `Baseline.departed`. */
static int stays(const Arrays *a, const Limits *limits, Py_ssize_t index, Py_ssize_t m, Work *w) {
    double offset[3], *moved = w->means, *unknown = w->noise; /* which the window is not yet needed for */
    find_usual(a, index, m, w->usual, offset);
    for (Py_ssize_t i = 0; i < m; i++) {
        const double *usual = w->usual + i * STATES, *covariance = a->first_covariance + i * STATES * STATES;
        moved[i] = unknown[i] = 0;
        for (int j = 0; j < STATES; j++) {
            moved[i] += (a->state[i * STATES + j] - a->first_state[i * STATES + j]) * usual[j];
            for (int l = 0; l < STATES; l++) unknown[i] += usual[j] * covariance[j * STATES + l] * usual[l];
        }
    }
    for (Py_ssize_t i = 0; i < m; i++) {
        double departure = 0, variance = 0;
        for (Py_ssize_t j = 0; j < m; j++) {
            double share = a->deleted[i * m + j];
            departure += share * moved[j];
            variance += share * share * unknown[j];
        }
        if (!(fabs(departure) < limits->drift + limits->sigmas * sqrt(variance))) return 0;
    }
    return 1;
}

/* The axes from which the normal model is updated; 0 if there may be a fault, or if an excluded group of axes may agree. The
   sum of squares of the means, before or after the triad is fitted, is an upper bound of the gain of every fault. */
static int find_sound(const Arrays *a, const Limits *limits, Py_ssize_t m, Work *w) {
    const double *included = a->masks, *waiting = a->masks + 2 * m;
    double least = INFINITY, greatest = 0, most = 0;
    int groups = 0;
    for (Py_ssize_t i = 0; i < m; i++) {
        w->weights[i] = included[i] ? 1 / w->doubt[i] : 0.0;
        if (included[i] && w->weights[i] < least) least = w->weights[i];
        if (w->weights[i] > greatest) greatest = w->weights[i];
        most += w->weights[i] * w->means[i] * w->means[i];
        w->sound[i] = included[i] != 0;
        if (waiting[i] >= groups) groups = (int)waiting[i] + 1;
    }
    double ratio = least / greatest;
    if (most < limits->axis_gain / 2 && limits->even * ratio * ratio * ratio > limits->uneven && !groups) return 1;
    double normal[3][3] = {{0}}, spread[3][3], sums[3] = {0}, triad[3] = {0};
    for (Py_ssize_t i = 0; i < m; i++)
        for (int j = 0; j < 3; j++) {
            double weighted = a->rows[3 * i + j] * w->weights[i];
            sums[j] += weighted * w->means[i];
            for (int l = 0; l < 3; l++) normal[j][l] += weighted * a->rows[3 * i + l];
        }
    if (!inverse(normal, spread)) return 0;
    for (int group = 0; group < groups; group++) {
        int off = 0;
        for (Py_ssize_t i = 0; i < m; i++)
            if (waiting[i] == group) {
                double others = quadratic(spread, a->rows + 3 * i);
                off |= w->means[i] * w->means[i] >= limits->agrees * (w->doubt[i] + others);
            }
        if (!off) return 0;
    }
    for (int j = 0; j < 3; j++)
        for (int l = 0; l < 3; l++) triad[j] += spread[j][l] * sums[l];
    double whole = 0;
    for (Py_ssize_t i = 0; i < m; i++) {
        double explained = 0;
        for (int j = 0; j < 3; j++) explained += a->rows[3 * i + j] * triad[j];
        w->shown[i] = w->weights[i] * w->means[i] - w->weights[i] * explained;
        whole += w->shown[i] * w->means[i];
    }
    if (!(whole < limits->axis_gain)) return 0;
    if (whole < limits->axis_gain / 2) return 1;
    for (Py_ssize_t i = 0; i < m; i++) {
        double weight = w->weights[i];
        double alone = weight - weight * weight * quadratic(spread, a->rows + 3 * i);
        double gain = alone > 1e-6 * weight ? w->shown[i] * w->shown[i] / alone : 0.0;
        w->sound[i] = gain < limits->axis_gain / 2 && included[i];
    }
    return 1;
}

/* Whether a window shows no fault; its residuals are those of the readings less those of the seven courses as made by the
   states. Their sum of squares over the noise alone is an upper bound of every energy. The results are in `w`. */
CLONES static int look(const Arrays *a, const Limits *limits, Py_ssize_t index, Py_ssize_t n, Py_ssize_t m, Work *w,
                double offset[3]) {
    const double *own = a->own + index * n * m, *courses = a->courses + index * n * COURSES;
    const double *jitter = a->jitter + index * m;
    find_usual(a, index, m, w->usual, offset);
    for (Py_ssize_t i = 0; i < m; i++) {
        const double *state = a->state + i * STATES;
        double explained = state[1] * offset[0] + state[2] * offset[1] + state[3] * offset[2];
        w->made[i] = state[0] - explained;
        for (int j = 0; j < 3; j++) w->made[(1 + j) * m + i] = state[1 + j];
        for (int j = 0; j < 3; j++) w->made[(4 + j) * m + i] = a->rows[3 * i + j] * state[4];
    }
    memset(w->seen_as, 0, COURSES * m * sizeof(double));
    memset(w->products, 0, COURSES * m * sizeof(double));
    for (int course = 0; course < COURSES; course++)
        for (Py_ssize_t from = 0; from < m; from++) {
            double factor = w->made[course * m + from];
            for (Py_ssize_t i = 0; i < m; i++) w->seen_as[course * m + i] += factor * a->blind[from * m + i];
        }
    memcpy(w->residual, own, n * m * sizeof(double));
    for (Py_ssize_t frame = 0; frame < n; frame++) {
        double *residual = w->residual + frame * m;
        for (int course = 0; course < COURSES; course++) {
            double factor = courses[frame * COURSES + course];
            for (Py_ssize_t i = 0; i < m; i++) residual[i] -= factor * w->seen_as[course * m + i];
        }
        for (int course = 0; course < COURSES; course++) {
            double factor = courses[frame * COURSES + course];
            for (Py_ssize_t i = 0; i < m; i++) w->products[course * m + i] += factor * residual[i];
        }
    }
    for (Py_ssize_t i = 0; i < m; i++) {
        double squares = 0;
        w->means[i] = w->products[i] / (double)n;
        for (Py_ssize_t frame = 0; frame < n; frame++) squares += w->residual[frame * m + i] * w->residual[frame * m + i];
        squares -= w->products[i] * w->means[i];
        if (!(squares * a->precision[i] < limits->limit)) return 0;
    }
    for (Py_ssize_t i = 0; i < m; i++) {
        double *usual = w->usual + i * STATES, *aged = w->aged + i * STATES * STATES, doubt = 0;
        for (int j = 0; j < STATES * STATES; j++)
            aged[j] = a->covariance[i * STATES * STATES + j] * a->kept[j] + a->fresh[j];
        aged[0] += limits->wander * a->variance[i];
        for (int j = 0; j < STATES; j++)
            for (int l = 0; l < STATES; l++) doubt += usual[j] * aged[j * STATES + l] * usual[l];
        w->noise[i] = a->colour[i] * a->variance[i] + jitter[i];
        w->doubt[i] = w->noise[i] / (double)n + doubt;
    }
    return find_sound(a, limits, m, w);
}

/* `NormalModel.learn` of one axis, with the sums as its state sees them: the triad less `offset`. 0: no solution. */
static int learn_state(const Arrays *a, const double *moments, const Work *w, Py_ssize_t i, Py_ssize_t m,
                       const double offset[3], double covariance[STATES][STATES], double change[STATES]) {
    double sheared[STATES][STATES], both[STATES][STATES], spoken[STATES][STATES], products[STATES];
    double weight = 1 / w->noise[i];
    for (int row = 0; row < STATES; row++)
        for (int column = 0; column < STATES; column++) {
            double less = row >= 1 && row <= 3 ? offset[row - 1] * moments[column] : 0.0;
            sheared[row][column] = moments[row * STATES + column] - less;
        }
    for (int row = 0; row < STATES; row++)
        for (int column = 0; column < STATES; column++) {
            double less = column >= 1 && column <= 3 ? offset[column - 1] * sheared[row][0] : 0.0;
            both[row][column] = (sheared[row][column] - less) * weight;
        }
    products[0] = w->products[i];
    for (int j = 0; j < 3; j++) products[1 + j] = w->products[(1 + j) * m + i] - offset[j] * w->products[i];
    products[4] = 0;
    for (int j = 0; j < 3; j++) products[4] += a->rows[3 * i + j] * w->products[(4 + j) * m + i];
    const double *aged = w->aged + i * STATES * STATES;
    for (int row = 0; row < STATES; row++)
        for (int column = 0; column < STATES; column++) {
            double sum = row == column ? 1.0 : 0.0;
            for (int j = 0; j < STATES; j++) sum += aged[row * STATES + j] * both[j][column];
            spoken[row][column] = sum;
            covariance[row][column] = aged[row * STATES + column];
        }
    if (!solve(spoken, covariance)) return 0;
    for (int row = 0; row < STATES; row++)
        for (int column = row + 1; column < STATES; column++)
            covariance[row][column] = covariance[column][row] = (covariance[row][column] + covariance[column][row]) / 2;
    for (int row = 0; row < STATES; row++) {
        change[row] = 0;
        for (int j = 0; j < STATES; j++) change[row] += covariance[row][j] * products[j] * weight;
    }
    return 1;
}

/* `NormalModel.learn_noise` of one axis, if it is `whole`. */
static void learn_noise(const Arrays *a, const Limits *limits, const Work *w, Py_ssize_t i, Py_ssize_t n, Py_ssize_t m,
                        int whole) {
    if (!whole) {
        a->before[i] = NAN;
        return;
    }
    double share = fmax(a->share[i], limits->least_share), squares = 0, mean = w->means[i];
    for (Py_ssize_t frame = 1; frame < n; frame++) {
        double step = w->residual[frame * m + i] - w->residual[(frame - 1) * m + i];
        squares += step * step;
    }
    double step = squares / ((double)(n - 1) * share), rate = 1 / fmin(a->seen[i] + 2, limits->change_windows);
    a->change[i] += rate * (fmin(step, 4 * a->change[i]) - a->change[i]);
    double spread = (double)n * (mean - a->before[i]) * (mean - a->before[i]) / (2 * share * a->variance[i]);
    if (isfinite(spread)) {
        rate = 1 / fmin(a->seen[i] + 10, limits->colour_windows);
        double colour = a->colour[i] + rate * (fmin(spread, 9 * a->colour[i]) - a->colour[i]);
        a->colour[i] = fmin(fmax(colour, 1.0), limits->longest_colour);
    }
    a->before[i] = mean;
    a->seen[i] += 1;
}

/* One window: 1 if it was judged and learnt from, 0 if it needs the Python code. */
static int pass(const Arrays *a, const Limits *limits, Py_ssize_t index, Py_ssize_t n, Py_ssize_t m, Work *w,
                double *covariances, double *changes_of_state) {
    const double *changes = a->changes + index * m, *moments = a->moments + index * m * STATES * STATES;
    const double *included = a->masks, *observable = a->masks + m;
    double offset[3];
    if (!moves(changes, a->change, m, limits->quiet) || !look(a, limits, index, n, m, w, offset)) return 0;
    for (Py_ssize_t i = 0; i < m; i++)
        if (w->sound[i] && !learn_state(a, moments + i * STATES * STATES, w, i, m, offset,
                                        (double (*)[STATES])(covariances + i * STATES * STATES),
                                        changes_of_state + i * STATES))
            return 0;
    for (Py_ssize_t i = 0; i < m; i++) {
        double *covariance = a->covariance + i * STATES * STATES;
        if (w->sound[i]) {
            memcpy(covariance, covariances + i * STATES * STATES, STATES * STATES * sizeof(double));
            for (int j = 0; j < STATES; j++) a->state[i * STATES + j] += changes_of_state[i * STATES + j];
        } else if (included[i])
            memcpy(covariance, w->aged + i * STATES * STATES, STATES * STATES * sizeof(double));
        int whole = w->sound[i] && observable[i] && changes[i] > limits->quietest * a->change[i];
        learn_noise(a, limits, w, i, n, m, whole);
    }
    return 1;
}

#define ARRAYS (sizeof(Arrays) / sizeof(double *))
#define WRITTEN 17 /* the first array that is written */

static PyObject *advance(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence, *result = NULL;
    Py_ssize_t k, n, m, begin, end, next, every, held = 0;
    Limits limits;
    if (!PyArg_ParseTuple(args, "O!(nnnnnnn)(dddddddddddddd)", &PyTuple_Type, &sequence, &k, &n, &m, &begin, &end, &next, &every,
                          &limits.limit, &limits.even, &limits.uneven, &limits.axis_gain, &limits.agrees, &limits.quiet,
                          &limits.quietest, &limits.wander, &limits.least_share, &limits.change_windows,
                          &limits.colour_windows, &limits.longest_colour, &limits.drift, &limits.sigmas))
        return NULL;
    if (m < 3 || m > MOST_AXES || m % 3 || n < 2 || n > MOST_FRAMES || k < 0 || begin < 0 || begin > end || end > k ||
        every < 1)
        return PyLong_FromSsize_t(0);
    const Py_ssize_t sizes[] = {k * n * m, k * n * COURSES, k * m * STATES, k * m, k * m * STATES * STATES, k * m,
                                m * m, 3 * m, 3 * m, m, m,
                                STATES * STATES, STATES * STATES, m, m * STATES, m * STATES * STATES, m * m,
                                m * STATES, m * STATES * STATES, m, m, m, m, 3 * m};
    Py_buffer views[ARRAYS];
    double *pointers[ARRAYS];
    if (PyTuple_Size(sequence) != (Py_ssize_t)ARRAYS) {
        PyErr_SetString(PyExc_ValueError, "another number of arrays is wanted");
        return NULL;
    }
    for (; held < (Py_ssize_t)ARRAYS; held++) {
        int written = held >= WRITTEN && held < (Py_ssize_t)ARRAYS - 1;
        int flags = written ? PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE : PyBUF_C_CONTIGUOUS;
        if (PyObject_GetBuffer(PyTuple_GetItem(sequence, held), &views[held], flags | PyBUF_FORMAT) < 0) goto finish;
        if (views[held].len != sizes[held] * (Py_ssize_t)sizeof(double) || strcmp(views[held].format, "d")) {
            PyErr_Format(PyExc_ValueError, "array %zd: %zd numbers of double precision are wanted", held, sizes[held]);
            held++;
            goto finish;
        }
        pointers[held] = views[held].buf;
    }
    Arrays arrays;
    memcpy(&arrays, pointers, sizeof(arrays));
    Work *work = PyMem_Malloc(sizeof(Work));
    double *room = PyMem_Malloc((size_t)(n * m + (2 * STATES * STATES + STATES) * m) * sizeof(double));
    if (work == NULL || room == NULL)
        PyErr_NoMemory();
    else {
        work->residual = room;
        work->aged = room + n * m;
        double *covariances = work->aged + m * STATES * STATES, *changes_of_state = covariances + m * STATES * STATES;
        Py_ssize_t index = begin;
        for (; index < end; index++) {
            int is_due = index >= next && (index - next) % every == 0;
            if (is_due && !stays(&arrays, &limits, index, m, work)) break;
            if (!pass(&arrays, &limits, index, n, m, work, covariances, changes_of_state)) break;
        }
        result = PyLong_FromSsize_t(index - begin);
    }
    PyMem_Free(work);
    PyMem_Free(room);
finish:
    while (held > 0) PyBuffer_Release(&views[--held]);
    return result;
}

static PyMethodDef methods[] = {
    {"advance", advance, METH_VARARGS,
     "advance(arrays, sizes, limits): judge windows of a series and learn from them, in place; how many it came through."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_windows", "Decision windows in which nothing happens.",
                                        0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__windows(void) { return PyModuleDef_Init(&definition); }

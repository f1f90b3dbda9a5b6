/* The search of `imuarray.gap.recording.course` for the stretch of windows that differs most from the rest: over all pairs
   of a begin and an end, of which a log with many phases has a million. */

#include "../_buffers.h"

#include <stdint.h>


typedef struct {
    const double *upto, *weights; /* (f, w + 1) sums of the windows before each; (w + 1) by the length of a stretch */
    Py_ssize_t count, statistics, fewest;
    double each; /* nats */
} Search;

/* Sums over statistics of what the stretches from `begin` to each end in [from, to) gain beyond `each`, into total. */
CLONES static void add_gains(const Search *s, Py_ssize_t begin, Py_ssize_t from, Py_ssize_t to, double *total) {
    const double count = (double)s->count, each = s->each;
    for (Py_ssize_t end = from; end < to; end++) total[end] = 0;
    for (Py_ssize_t f = 0; f < s->statistics; f++) {
        const double *upto = s->upto + f * (s->count + 1);
        const double before = upto[begin], mean = upto[s->count] / count, *weights = s->weights - begin;
        for (Py_ssize_t end = from; end < to; end++) {
            const double apart = (upto[end] - before) - (double)(end - begin) * mean;
            const double gain = apart * apart * weights[end] - each;
            total[end] += gain > 0 ? gain : 0;
        }
    }
}

/* The begins and ends whose gain is at least `share` of the largest, in order, into places (room, 2): how many there are,
   or room + 1 for more. */
static Py_ssize_t largest(const Search *s, double share, double *total, double *row_most, int64_t *places, Py_ssize_t room) {
    double most = 0;
    for (int pass = 0; pass < 2; pass++) {
        Py_ssize_t kept = 0;
        for (Py_ssize_t begin = 0; begin <= s->count - s->fewest; begin++) {
            const Py_ssize_t from = begin + s->fewest, to = s->count - s->fewest + 1;
            if ((begin > 0 && begin < s->fewest) || (pass && row_most[begin] < share * most)) continue;
            add_gains(s, begin, from, to > from ? to : from, total);
            if (begin) add_gains(s, begin, s->count, s->count + 1, total);
            for (Py_ssize_t end = from; end <= s->count; end++) {
                if (end >= to && (end < s->count || !begin)) continue;
                if (!pass) {
                    if (end == from || total[end] > row_most[begin]) row_most[begin] = total[end];
                } else if (total[end] >= share * most) {
                    if (kept == room) return room + 1;
                    places[2 * kept] = begin, places[2 * kept + 1] = end;
                    kept++;
                }
            }
            if (row_most[begin] > most) most = row_most[begin];
        }
        if (pass) return kept;
    }
    return 0;
}

static PyObject *clearest(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t count, statistics, fewest, room, kept = 0;
    double each, share;
    if (!PyArg_ParseTuple(args, "O!(nnnn)dd", &PyTuple_Type, &sequence, &count, &statistics, &fewest, &room, &each, &share))
        return NULL;
    if (!sizes_allowed(fewest >= 1 && count >= 2 * fewest && statistics >= 1 && room >= 1)) return NULL;
    const Py_ssize_t bytes[] = {DOUBLES(statistics * (count + 1)), DOUBLES(count + 1), DOUBLES(2 * (count + 1)),
                                2 * room * (Py_ssize_t)sizeof(int64_t)};
    Py_buffer views[4];
    Py_ssize_t held = hold(sequence, views, 4, bytes, 2);
    if (!PyErr_Occurred()) {
        const Search search = {views[0].buf, views[1].buf, count, statistics, fewest, each};
        double *work = views[2].buf;
        Py_BEGIN_ALLOW_THREADS;
        for (Py_ssize_t i = 0; i < 2 * (count + 1); i++) work[i] = 0;
        kept = largest(&search, share, work, work + count + 1, views[3].buf, room);
        Py_END_ALLOW_THREADS;
    }
    while (held > 0) PyBuffer_Release(&views[--held]);
    return PyErr_Occurred() ? NULL : PyLong_FromSsize_t(kept);
}

static PyMethodDef methods[] = {
    {"clearest", clearest, METH_VARARGS,
     "clearest(arrays, sizes, each, share): the stretches that gain nearly as much as the one that gains most."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_stretches", "Stretches of windows.", 0, methods, slots, NULL,
                                        NULL, NULL};

PyMODINIT_FUNC PyInit__stretches(void) { return PyModuleDef_Init(&definition); }

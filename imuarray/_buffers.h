/* What compiled functions have in common: the arrays that they get from Python, a tuple of buffers of stated sizes, and
   the processors that they are compiled for. */

#pragma once

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

/* Code for processors with AVX2 beside the code for all others, chosen when the module is loaded. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__)
#define CLONES __attribute__((target_clones("avx2", "default")))
#else
#define CLONES
#endif

#define DOUBLES(count) ((count) * (Py_ssize_t)sizeof(double))

/* The buffers of a tuple of arrays, each of so many bytes, the first `read` of them read only; how many are held, less
   than `count` after an error. */
static inline Py_ssize_t hold(PyObject *sequence, Py_buffer *views, Py_ssize_t count, const Py_ssize_t *bytes, Py_ssize_t read) {
    if (PyTuple_Size(sequence) != count) {
        PyErr_SetString(PyExc_ValueError, "another number of arrays is required");
        return 0;
    }
    for (Py_ssize_t held = 0; held < count; held++) {
        int flags = held >= read ? PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE : PyBUF_C_CONTIGUOUS;
        if (PyObject_GetBuffer(PyTuple_GetItem(sequence, held), &views[held], flags) < 0) return held;
        if (views[held].len != bytes[held]) {
            PyErr_Format(PyExc_ValueError, "array %zd: %zd bytes are required", held, bytes[held]);
            return held + 1;
        }
    }
    return count;
}

static inline PyObject *released(Py_buffer *views, Py_ssize_t held) {
    while (held > 0) PyBuffer_Release(&views[--held]);
    if (PyErr_Occurred()) return NULL;
    return Py_NewRef(Py_None);
}

static inline int sizes_allowed(int allowed) {
    if (!allowed) PyErr_SetString(PyExc_ValueError, "other sizes are required");
    return allowed;
}

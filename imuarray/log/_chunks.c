/* Two of HDF5's filters, for `imuarray.log.chunks`: the order of bytes that compresses better, and the check sum of a
   chunk. */

#include "../_buffers.h"

#include <stdint.h>

#define UNFOLDED 360 /* words that are added before the sums are folded, so that 32 bits hold them */

/* The first bytes of all values (n of `width` bytes), then the second ones, and so on. */
static PyObject *shuffle(PyObject *module, PyObject *args) {
    (void)module;
    PyObject *sequence;
    Py_ssize_t n, width;
    if (!PyArg_ParseTuple(args, "O!(nn)", &PyTuple_Type, &sequence, &n, &width)) return NULL;
    if (!sizes_allowed(n >= 0 && width >= 1)) return NULL;
    const Py_ssize_t bytes[] = {n * width, n * width};
    Py_buffer views[2];
    Py_ssize_t held = hold(sequence, views, 2, bytes, 1);
    if (!PyErr_Occurred()) {
        const uint8_t *values = views[0].buf;
        uint8_t *planes = views[1].buf;
        for (Py_ssize_t byte = 0; byte < width; byte++)
            for (Py_ssize_t i = 0; i < n; i++) planes[byte * n + i] = values[i * width + byte];
    }
    return released(views, held);
}

static uint32_t folded(uint32_t sum) { return (sum & 0xFFFF) + (sum >> 16); }

/* Fletcher's sum of 32 bits over words of two bytes, the higher first; a last single byte is a higher one. */
static PyObject *fletcher32(PyObject *module, PyObject *args) {
    (void)module;
    Py_buffer view;
    if (!PyArg_ParseTuple(args, "y*", &view)) return NULL;
    const uint8_t *data = view.buf;
    const Py_ssize_t words = view.len / 2;
    uint32_t low = 0, high = 0;
    for (Py_ssize_t begin = 0; begin < words; begin += UNFOLDED) {
        const Py_ssize_t end = begin + UNFOLDED < words ? begin + UNFOLDED : words;
        for (Py_ssize_t word = begin; word < end; word++) {
            low += (uint32_t)data[2 * word] << 8 | data[2 * word + 1];
            high += low;
        }
        low = folded(low);
        high = folded(high);
    }
    if (view.len % 2) {
        low = folded(low + ((uint32_t)data[view.len - 1] << 8));
        high = folded(high + low);
    }
    PyBuffer_Release(&view);
    return PyLong_FromUnsignedLong((unsigned long)folded(high) << 16 | folded(low));
}

static PyMethodDef methods[] = {
    {"fletcher32", fletcher32, METH_VARARGS, "fletcher32(data): the check sum of bytes."},
    {"shuffle", shuffle, METH_VARARGS, "shuffle(arrays, sizes): bytes of values in the order of their significance."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_chunks", "Filters of chunks.", 0, methods, slots, NULL, NULL,
                                        NULL};

PyMODINIT_FUNC PyInit__chunks(void) { return PyModuleDef_Init(&definition); }

/* Functions that rmw calls in place of a service's own serializers; see rcl.py.
 *
 * The three functions do not use Python. Fast CDR is C++: its exceptions pass through them to rmw, which expects
 * them. It is not linked: its addresses are passed in once, so that this file compiles without ROS.
 */

#include <Python.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { HEADER = 4, SEARCHED = 32 };

/* rcl.Wire: a whole message, with its encapsulation header */
typedef struct {
    char *start;
    size_t length;
    size_t capacity;
    char *exact; /* where to put a message of `exact_length` bytes instead; NULL afterwards */
    size_t exact_length;
} Wire;

static void *(*append)(void *cdr, const char *bytes, size_t count); /* Cdr::serialize_array */
static char *(*begin)(const void *cdr);                             /* Cdr::get_buffer_pointer */

/* bool cdr_serialize(const void *, Cdr &); the header has been written already */
static bool serialize(const void *message, void *cdr)
{
    const Wire *wire = message;
    if (wire->length < HEADER) {
        return false;
    }
    append(cdr, wire->start + HEADER, wire->length - HEADER);
    return true;
}

/* uint32_t get_serialized_size(const void *), without the header */
static uint32_t serialized_size(const void *message)
{
    const Wire *wire = message;
    return wire->length < HEADER ? 0 : (uint32_t)(wire->length - HEADER);
}

/* Cdr ends with three iterators, each with the buffer's begin and a position: current, the message's begin, its end. */
static char *end_of(const void *cdr, const char *first)
{
    char *words[6];
    for (int at = 0; at < SEARCHED; at++) {
        memcpy(words, (const char *)cdr + at * sizeof *words, sizeof words);
        if (words[0] == first && words[2] == first && words[4] == first) {
            return words[5];
        }
    }
    return NULL;
}

/* bool cdr_deserialize(Cdr &, void *): the whole buffer, its header too */
static bool deserialize(void *cdr, void *message)
{
    Wire *wire = message;
    const char *first = begin(cdr);
    const char *end = end_of(cdr, first);
    if (end == NULL || end < first) {
        return false;
    }
    size_t length = (size_t)(end - first);
    if (wire->exact != NULL && wire->exact_length == length) {
        memcpy(wire->exact, first, length);
        wire->exact = NULL;
        wire->length = length;
        return true;
    }
    if (wire->capacity < length) {
        char *start = realloc(wire->start, length);
        if (start == NULL) {
            return false;
        }
        wire->start = start;
        wire->capacity = length;
    }
    if (length > 0) {
        memcpy(wire->start, first, length);
    }
    wire->length = length;
    return true;
}

static PyObject *addresses(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *append_at, *begin_at;
    if (!PyArg_ParseTuple(args, "OO", &append_at, &begin_at)) {
        return NULL;
    }
    void *found[] = {PyLong_AsVoidPtr(append_at), PyLong_AsVoidPtr(begin_at)};
    if (PyErr_Occurred()) {
        return NULL;
    }
    if (found[0] == NULL || found[1] == NULL) {
        PyErr_SetString(PyExc_ValueError, "the addresses of Fast CDR's functions must not be 0");
        return NULL;
    }
    append = (void *(*)(void *, const char *, size_t))found[0];
    begin = (char *(*)(const void *))found[1];
    return Py_BuildValue("(NNN)", PyLong_FromVoidPtr((void *)serialize), PyLong_FromVoidPtr((void *)deserialize),
                         PyLong_FromVoidPtr((void *)serialized_size));
}

static PyMethodDef methods[] = {
    {"addresses", addresses, METH_VARARGS,
     "Set the addresses of Fast CDR's serialize_array and get_buffer_pointer; return those of serialize, deserialize, size."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "service_callbacks", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_service_callbacks(void)
{
    return PyModule_Create(&module);
}

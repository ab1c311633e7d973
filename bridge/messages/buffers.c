/* Converts large messages from one buffer to another, without the interpreter's lock. */

#define PY_SSIZE_T_CLEAN
#include "transcode/program.h"

/* Reads a program and a message; the caller releases the view. */
static int read_message(Message *message, Program *program, PyObject *native, const Py_buffer *view)
{
    *program = (Program){0};
    *message = (Message){program, view->buf, view->len, 0, false};
    return set_program(program, native);
}

static PyObject *measured(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *native, *result = NULL;
    Py_buffer view;
    Program program;
    Message message;
    if (!PyArg_ParseTuple(args, "Oy*", &native, &view)) {
        return NULL;
    }
    if (read_message(&message, &program, native, &view) == 0) {
        bool valid;
        Py_BEGIN_ALLOW_THREADS
        valid = measure(&message);
        Py_END_ALLOW_THREADS
        result = valid ? Py_BuildValue("LN", (long long)message.converted, PyBool_FromLong(message.copies))
                       : Py_NewRef(Py_None);
    }
    PyBuffer_Release(&view);
    return result;
}

/* Sets what `measured` has returned; fails if that cannot belong to the message. */
static int set_measured(Message *message, long long size, int copies)
{
    message->converted = size;
    message->copies = copies || message->program->run == NULL;
    if (size < 0 || (message->copies && message->size < size)) {
        PyErr_Format(PyExc_ValueError, "the converted form of %lld bytes cannot have %lld", (long long)message->size, size);
        return -1;
    }
    return 0;
}

/* Writes a message, which `measured` has checked, to a place of the measured size. */
static int write_at(const Message *message, char *place)
{
    bool written;
    Py_BEGIN_ALLOW_THREADS
    written = write_converted(message, place);
    Py_END_ALLOW_THREADS
    if (!written) {
        PyErr_SetString(PyExc_ValueError, "the message changed while it was converted");
    }
    return written ? 0 : -1;
}

static PyObject *write_to(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *native;
    Py_buffer view, place;
    Program program;
    Message message;
    long long size;
    int copies;
    if (!PyArg_ParseTuple(args, "Oy*Lpw*", &native, &view, &size, &copies, &place)) {
        return NULL;
    }
    int failed = read_message(&message, &program, native, &view);
    failed = failed < 0 ? failed : set_measured(&message, size, copies);
    if (failed == 0 && place.len < size) {
        PyErr_Format(PyExc_ValueError, "a place of %zd bytes has no room for %lld", place.len, size);
        failed = -1;
    }
    if (failed == 0) {
        failed = write_at(&message, place.buf);
    }
    PyBuffer_Release(&place);
    PyBuffer_Release(&view);
    return failed < 0 ? NULL : Py_NewRef(Py_None);
}

static PyObject *converted(PyObject *Py_UNUSED(module), PyObject *args)
{
    PyObject *native, *result = NULL;
    Py_buffer view;
    Program program;
    Message message;
    long long size;
    int copies;
    if (!PyArg_ParseTuple(args, "Oy*Lp", &native, &view, &size, &copies)) {
        return NULL;
    }
    if (read_message(&message, &program, native, &view) == 0 && set_measured(&message, size, copies) == 0) {
        result = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)size);
    }
    if (result != NULL && write_at(&message, PyBytes_AsString(result)) < 0) {
        Py_CLEAR(result);
    }
    PyBuffer_Release(&view);
    return result;
}

static PyMethodDef methods[] = {
    {"measured", measured, METH_VARARGS,
     "Return the size of a message's converted form, and whether it is the message's beginning; None if it is invalid."},
    {"write_to", write_to, METH_VARARGS, "Write the converted form, with the results of `measured`, to a buffer."},
    {"converted", converted, METH_VARARGS, "Return the converted form, given the results of `measured`."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "buffers", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_buffers(void)
{
    return PyModule_Create(&module);
}

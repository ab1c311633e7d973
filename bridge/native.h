/* What the modules in C share. */

#ifndef MIDSPAN_NATIVE_H
#define MIDSPAN_NATIVE_H

#include <Python.h>
#include <stdbool.h>

/* Frees an object of a heap type. */
static inline void release(PyObject *self)
{
    PyTypeObject *type = Py_TYPE(self);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

/* Returns whether one of the calls, each the method `locked` of a lock, returns true or fails. */
static inline bool is_any_locked(PyObject *calls)
{
    for (Py_ssize_t at = 0; at < PyTuple_Size(calls); at++) {
        PyObject *answer = PyObject_CallNoArgs(PyTuple_GetItem(calls, at));
        bool locked = answer != Py_False;
        Py_XDECREF(answer);
        if (locked) {
            return true;
        }
    }
    return false;
}

#endif

/* The interface through which a side's publishers send without the interpreter, and conditions that both ways share. */

#ifndef MIDSPAN_OUTPUT_H
#define MIDSPAN_OUTPUT_H

#include <Python.h>
#include <stdbool.h>
#include <stddef.h>

#define OUTPUT "bridge.routing.output"

enum { PREFIX = 4 }; /* bytes before a message, which an output may overwrite */

/* What the attribute `output` of an object contains, in a capsule. Neither function may be called with an exception. */
typedef struct {
    /* Returns whether a message can be sent now; runs no Python code. */
    bool (*is_ready)(PyObject *owner);
    /* Sends a message and returns true; or returns false, and has neither done anything nor run Python code. */
    bool (*send)(PyObject *owner, char *message, size_t size);
} Output;

/* bridge.routing.doorway.Deadline */
typedef struct {
    PyObject_HEAD
    double until;
} Deadline;

/* Returns whether velocities are held: the attribute `held` of an object (bridge.routing.hold), False for None. */
static inline bool is_held(PyObject *hold)
{
    if (hold == Py_None) {
        return false;
    }
    PyObject *held = PyObject_GetAttrString(hold, "held");
    bool is = held != Py_False;
    Py_XDECREF(held);
    PyErr_Clear();
    return is;
}

#endif

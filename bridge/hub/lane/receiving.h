/* The interface through which messages from a lane are handled without the interpreter. */

#ifndef MIDSPAN_RECEIVING_H
#define MIDSPAN_RECEIVING_H

#include <Python.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define ACCEPTOR "bridge.hub.lane.receiving.acceptor"

/* What the attribute `acceptor` of an object contains, in a capsule. */
typedef struct {
    /* Handles a message and returns true; or returns false, and has neither done anything nor run Python code. */
    bool (*accept)(PyObject *owner, PyObject *gid, const char *payload, size_t size, int64_t time_ns);
} Acceptor;

#endif

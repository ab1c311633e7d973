/* What other compiled modules use of links.c. */

#ifndef MIDSPAN_LINKS_H
#define MIDSPAN_LINKS_H

#include <Python.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { MAX_JOINED_BYTES = 4096 }; /* as in bridge.hub.lane.joining */

#define LINKS_API "bridge.hub.lane.links.api"

typedef struct {
    PyTypeObject *sender_type;
    /* Returns whether nothing prevents a message from being sent to all readers now. */
    bool (*is_ready)(PyObject *sender);
    /* Numbers a message of at most MAX_JOINED_BYTES, has `write` put it into each link's record, and sends or joins it. */
    void (*send)(PyObject *sender, int64_t time_ns, size_t size, void (*write)(void *context, char *place), void *context);
} LinksApi;

#endif

/* Gives other threads a turn while C code holds the interpreter's lock for long. */

#ifndef MIDSPAN_TURN_H
#define MIDSPAN_TURN_H

#include <Python.h>
#include <stdint.h>
#include <time.h>

enum { TURN = 3 }; /* milliseconds, after which threads change as between Python's instructions */

static inline int64_t milliseconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Releases the interpreter's lock for a moment if the turn that began at `begun` is over, and begins a new one. */
static inline void give_turn(int64_t *begun)
{
    if (milliseconds() - *begun >= TURN) {
        Py_BEGIN_ALLOW_THREADS
        Py_END_ALLOW_THREADS
        *begun = milliseconds();
    }
}

#endif

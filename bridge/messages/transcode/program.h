/* Conversions by the virtual machine (bridge.messages.transcode.vm), and clocks. */

#ifndef MIDSPAN_PROGRAM_H
#define MIDSPAN_PROGRAM_H

#include <Python.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

typedef int64_t (*Run)(const int64_t *words, const unsigned char *literals, const unsigned char *source, int64_t size,
                       unsigned char *target, int64_t room); /* vm._run */

typedef struct {
    Run run; /* NULL if the bytes stay the same */
    const int64_t *words;
    const unsigned char *literals;
    int64_t dirty;
    int checks; /* the bytes stay the same if they are not dirty */
} Program;

/* A message that is being converted. */
typedef struct {
    const Program *program;
    const unsigned char *bytes;
    int64_t size, converted;
    bool copies;
} Message;

/* Reads what `conversion.native_program` returns, which has to outlive the program. */
static inline int set_program(Program *program, PyObject *native)
{
    unsigned long long run;
    long long dirty;
    PyObject *words, *literals;
    if (native == Py_None) {
        return 0;
    }
    if (!PyArg_ParseTuple(native, "pKLSS", &program->checks, &run, &dirty, &words, &literals)) {
        return -1;
    }
    program->run = (Run)(uintptr_t)run;
    program->dirty = dirty;
    program->words = (const int64_t *)(const void *)PyBytes_AsString(words);
    program->literals = (const unsigned char *)PyBytes_AsString(literals);
    return 0;
}

/* Checks a message and measures its converted form; returns false if it is invalid. */
static inline bool measure(Message *message)
{
    const Program *program = message->program;
    message->copies = program->run == NULL;
    message->converted = message->size;
    if (!message->copies) {
        int64_t measured = program->run(program->words, program->literals, message->bytes, message->size, NULL, 0);
        if (measured < 0) {
            return false;
        }
        message->copies = program->checks && (measured & program->dirty) == 0;
        message->converted = measured & ~program->dirty;
    }
    return true;
}

/* Writes the converted form, at most the measured size; returns false if the message has changed since `measure`, which
   is possible only in memory that another process shares. */
static inline bool write_converted(const Message *message, char *place)
{
    const Program *program = message->program;
    if (message->copies) {
        memcpy(place, message->bytes, (size_t)message->converted);
        return true;
    }
    int64_t written = program->run(program->words, program->literals, message->bytes, message->size, (unsigned char *)place,
                                   message->converted);
    return written >= 0 && (written & ~program->dirty) == message->converted;
}

static inline int64_t nanoseconds(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static inline double monotonic(void)
{
    return 1e-9 * (double)nanoseconds(CLOCK_MONOTONIC);
}

#endif

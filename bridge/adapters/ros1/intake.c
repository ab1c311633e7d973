/* Waits for connections, and reads the small messages of ROS 1 publishers, without the interpreter.
 *
 * A stream is left to Python while it is not `direct`: part of a message has arrived, or a large one, or the connection
 * has ended. The interpreter's lock is held except while waiting.
 */

#define PY_SSIZE_T_CLEAN
#include "../../native.h"
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <structmember.h>

#ifdef __linux__
#include <errno.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include "../../turn.h"

enum { EVENTS = 64, CHUNK = 64 * 1024, PREFIX = 4 };

typedef struct {
    PyObject_HEAD
    PyObject *deliver, *source; /* deliver(payload, source, None) */
    PyObject *rest;             /* bytes that were received, and are left to Python; NULL: none */
    PyObject *error;            /* what `deliver` has raised; NULL: nothing */
    Py_ssize_t limit;
    long long messages, bytes;
    char direct, closed, reading;
} Stream;

typedef struct {
    PyObject_HEAD
    PyObject *flush; /* called before waiting */
    int epoll, room;
    bool pending; /* whether messages were delivered since the last flush */
    Stream **streams; /* by descriptor */
    char buffer[CHUNK];
} Intake;

static PyTypeObject *stream_type;

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* -- streams -- */

static void keep_error(Stream *stream)
{
    PyObject *type, *value, *traceback;
    PyErr_Fetch(&type, &value, &traceback);
    PyErr_NormalizeException(&type, &value, &traceback);
    if (value != NULL && traceback != NULL) {
        PyException_SetTraceback(value, traceback);
    }
    Py_XDECREF(stream->error);
    stream->error = Py_XNewRef(value);
    Py_XDECREF(type);
    Py_XDECREF(value);
    Py_XDECREF(traceback);
}

static bool deliver(Stream *stream, const char *data, uint32_t size)
{
    PyObject *payload = PyBytes_FromStringAndSize(data, (Py_ssize_t)size);
    PyObject *done =
        payload == NULL ? NULL : PyObject_CallFunctionObjArgs(stream->deliver, payload, stream->source, Py_None, NULL);
    Py_XDECREF(payload);
    Py_XDECREF(done);
    return done != NULL;
}

/* Delivers the whole small messages at the beginning of some bytes, and returns how many bytes these are. */
static size_t deliver_all(Stream *stream, const char *data, size_t length)
{
    int64_t begun = milliseconds();
    size_t at = 0;
    while (stream->direct && !stream->closed && length - at >= PREFIX) {
        const unsigned char *prefix = (const unsigned char *)data + at;
        uint32_t size = prefix[0] | (uint32_t)prefix[1] << 8 | (uint32_t)prefix[2] << 16 | (uint32_t)prefix[3] << 24;
        if ((Py_ssize_t)size > stream->limit || length - at - PREFIX < size) {
            break;
        }
        stream->bytes += PREFIX + (long long)size;
        stream->messages++;
        at += PREFIX + size;
        if (!deliver(stream, data + at - size, size)) {
            keep_error(stream);
            break;
        }
        give_turn(&begun);
    }
    return at;
}

/* Reads what has arrived; returns false if Python has to read on. */
static bool read_stream(Stream *stream, int descriptor, char *buffer)
{
    if (!stream->direct || stream->closed || stream->rest != NULL) {
        return false;
    }
    ssize_t received = recv(descriptor, buffer, CHUNK, MSG_DONTWAIT);
    if (received <= 0) {
        return received < 0 && (errno == EAGAIN || errno == EINTR);
    }
    stream->reading = 1;
    size_t whole = deliver_all(stream, buffer, (size_t)received);
    if (whole < (size_t)received || stream->error != NULL) {
        stream->direct = 0;
        stream->rest = PyBytes_FromStringAndSize(buffer + whole, received - (ssize_t)whole);
        if (stream->rest == NULL) {
            keep_error(stream);
        }
    }
    stream->reading = stream->rest != NULL || stream->error != NULL; /* until Python takes it */
    return stream->direct && !stream->closed;
}

static PyObject *stream_take(PyObject *self, PyObject *Py_UNUSED(unused))
{
    Stream *stream = (Stream *)self;
    PyObject *rest = stream->rest, *error = stream->error;
    stream->rest = stream->error = NULL;
    stream->reading = 0;
    if (error != NULL) {
        PyErr_SetObject((PyObject *)Py_TYPE(error), error);
        Py_DECREF(error);
        Py_CLEAR(rest);
        return NULL;
    }
    return rest != NULL ? rest : PyBytes_FromStringAndSize("", 0);
}

static int stream_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Stream *stream = (Stream *)self;
    PyObject *call, *source;
    if (!PyArg_ParseTuple(args, "OOn", &call, &source, &stream->limit)) {
        return -1;
    }
    Py_XDECREF(stream->deliver);
    Py_XDECREF(stream->source);
    stream->deliver = Py_NewRef(call);
    stream->source = Py_NewRef(source);
    stream->direct = 1;
    return 0;
}

static int stream_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((Stream *)self)->deliver);
    Py_VISIT(((Stream *)self)->error);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int stream_clear(PyObject *self)
{
    Stream *stream = (Stream *)self;
    stream->direct = 0;
    Py_CLEAR(stream->deliver);
    Py_CLEAR(stream->error);
    return 0;
}

static void stream_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    stream_clear(self);
    Py_XDECREF(((Stream *)self)->source);
    Py_XDECREF(((Stream *)self)->rest);
    release(self);
}

/* -- the intake -- */

/* Returns whether the descriptor's messages were read here. */
static bool read_here(Intake *intake, int descriptor, uint32_t events)
{
    Stream *stream = descriptor < intake->room ? intake->streams[descriptor] : NULL;
    if (stream == NULL || events != EPOLLIN) {
        return false;
    }
    Py_INCREF((PyObject *)stream);
    bool read = read_stream(stream, descriptor, intake->buffer);
    Py_DECREF((PyObject *)stream);
    intake->pending = true;
    return read;
}

static int send_pending(Intake *intake)
{
    if (!intake->pending) {
        return 0;
    }
    intake->pending = false;
    PyObject *done = PyObject_CallNoArgs(intake->flush);
    Py_XDECREF(done);
    return done == NULL ? -1 : 0;
}

static int wait_for(Intake *intake, struct epoll_event *events, double until)
{
    int count;
    Py_BEGIN_ALLOW_THREADS
    double left = until < 0.0 ? -1.0 : until - seconds();
    int timeout = until < 0.0 ? -1 : left <= 0.0 ? 0 : left > 1e6 ? 1000000000 : (int)(1000.0 * left) + 1;
    count = epoll_wait(intake->epoll, events, EVENTS, timeout);
    if (count < 0 && errno == EINTR) {
        count = 0;
    }
    Py_END_ALLOW_THREADS
    return count;
}

static PyObject *intake_wait(PyObject *self, PyObject *pause)
{
    Intake *intake = (Intake *)self;
    double limit = pause == Py_None ? -1.0 : PyFloat_AsDouble(pause);
    double until = limit < 0.0 ? -1.0 : seconds() + limit;
    struct epoll_event events[EVENTS];
    PyObject *others = PyErr_Occurred() ? NULL : PyList_New(0);
    bool ended = false;
    while (others != NULL && !ended) {
        int count = send_pending(intake) < 0 ? -1 : wait_for(intake, events, until);
        if (count < 0) {
            if (!PyErr_Occurred()) {
                PyErr_SetFromErrno(PyExc_OSError);
            }
            Py_CLEAR(others);
            break;
        }
        ended = until >= 0.0 && seconds() >= until;
        for (int at = 0; at < count; at++) {
            if (read_here(intake, events[at].data.fd, events[at].events)) {
                Py_BEGIN_ALLOW_THREADS /* for a thread that has waited long enough */
                Py_END_ALLOW_THREADS
                continue;
            }
            PyObject *other = Py_BuildValue("iI", events[at].data.fd, (unsigned int)events[at].events);
            if (other == NULL || PyList_Append(others, other) < 0) {
                PyErr_WriteUnraisable(self); /* no memory: epoll reports the descriptor again */
            }
            Py_XDECREF(other);
            ended = true;
        }
    }
    return others;
}

static PyObject *intake_add(PyObject *self, PyObject *args)
{
    Intake *intake = (Intake *)self;
    int descriptor;
    PyObject *stream;
    if (!PyArg_ParseTuple(args, "iO!", &descriptor, stream_type, &stream)) {
        return NULL;
    }
    if (descriptor < 0) {
        PyErr_SetString(PyExc_ValueError, "the connection is closed");
        return NULL;
    }
    if (descriptor >= intake->room) {
        int room = 2 * descriptor + 64;
        Stream **streams = PyMem_Realloc(intake->streams, (size_t)room * sizeof *streams);
        if (streams == NULL) {
            return PyErr_NoMemory();
        }
        memset(streams + intake->room, 0, (size_t)(room - intake->room) * sizeof *streams);
        intake->streams = streams;
        intake->room = room;
    }
    PyObject *before = (PyObject *)intake->streams[descriptor];
    intake->streams[descriptor] = (Stream *)Py_NewRef(stream);
    Py_XDECREF(before);
    Py_RETURN_NONE;
}

static void forget(Intake *intake, int descriptor)
{
    if (descriptor >= 0 && descriptor < intake->room) {
        Stream *stream = intake->streams[descriptor];
        intake->streams[descriptor] = NULL;
        Py_XDECREF((PyObject *)stream);
    }
}

static PyObject *intake_remove(PyObject *self, PyObject *descriptor)
{
    long number = PyLong_AsLong(descriptor);
    if (number == -1 && PyErr_Occurred()) {
        return NULL;
    }
    forget((Intake *)self, (int)number);
    Py_RETURN_NONE;
}

static int intake_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Intake *intake = (Intake *)self;
    PyObject *flush;
    if (!PyArg_ParseTuple(args, "iO", &intake->epoll, &flush)) {
        return -1;
    }
    Py_XDECREF(intake->flush);
    intake->flush = Py_NewRef(flush);
    return 0;
}

static int intake_traverse(PyObject *self, visitproc visit, void *arg)
{
    Intake *intake = (Intake *)self;
    for (int at = 0; at < intake->room; at++) {
        Py_VISIT((PyObject *)intake->streams[at]);
    }
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int intake_clear(PyObject *self)
{
    for (int at = 0; at < ((Intake *)self)->room; at++) {
        forget((Intake *)self, at);
    }
    return 0;
}

static void intake_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    intake_clear(self);
    PyMem_Free(((Intake *)self)->streams);
    Py_XDECREF(((Intake *)self)->flush);
    release(self);
}

/* -- the module -- */

static PyMemberDef stream_members[] = {
    {"direct", T_BOOL, offsetof(Stream, direct), 0, NULL},
    {"closed", T_BOOL, offsetof(Stream, closed), 0, NULL},
    {"reading", T_BOOL, offsetof(Stream, reading), READONLY, NULL},
    {"messages", T_LONGLONG, offsetof(Stream, messages), 0, NULL},
    {"bytes", T_LONGLONG, offsetof(Stream, bytes), 0, NULL},
    {NULL},
};
static PyMethodDef stream_methods[] = {
    {"take", stream_take, METH_NOARGS, "Return the bytes that are left to Python; raise what `deliver` has raised."},
    {NULL, NULL, 0, NULL},
};
static PyType_Slot stream_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, stream_init}, {Py_tp_dealloc, stream_dealloc},
    {Py_tp_traverse, stream_traverse}, {Py_tp_clear, stream_clear}, {Py_tp_methods, stream_methods},
    {Py_tp_members, stream_members}, {0, NULL},
};
static PyType_Spec stream_spec = {
    "bridge.adapters.ros1.intake.Stream", sizeof(Stream), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, stream_slots,
};

static PyMethodDef intake_methods[] = {
    {"wait", intake_wait, METH_O,
     "Read streams for some seconds, or without a limit (None); return early, with other descriptors that are ready and "
     "their events."},
    {"add", intake_add, METH_VARARGS, "Read a descriptor's stream."},
    {"remove", intake_remove, METH_O, "Stop reading a descriptor."},
    {NULL, NULL, 0, NULL},
};
static PyType_Slot intake_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, intake_init}, {Py_tp_dealloc, intake_dealloc},
    {Py_tp_traverse, intake_traverse}, {Py_tp_clear, intake_clear}, {Py_tp_methods, intake_methods}, {0, NULL},
};
static PyType_Spec intake_spec = {
    "bridge.adapters.ros1.intake.Intake", sizeof(Intake), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, intake_slots,
};

static int add_types(PyObject *module)
{
    stream_type = (PyTypeObject *)PyType_FromSpec(&stream_spec);
    PyObject *intake_type = PyType_FromSpec(&intake_spec);
    int failed = stream_type == NULL || intake_type == NULL ||
                 PyModule_AddObjectRef(module, "Stream", (PyObject *)stream_type) < 0 ||
                 PyModule_AddObjectRef(module, "Intake", intake_type) < 0;
    Py_XDECREF(intake_type);
    return failed ? -1 : 0;
}

#else

static int add_types(PyObject *Py_UNUSED(module))
{
    return 0;
}

#endif

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "intake", .m_size = -1};

PyMODINIT_FUNC PyInit_intake(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made != NULL && add_types(made) < 0) {
        Py_CLEAR(made);
    }
    return made;
}

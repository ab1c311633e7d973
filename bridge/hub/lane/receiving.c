/* Reads a lane, and hands over its plain messages without the interpreter.
 *
 * A message is plain if it is the next one of its publisher, and if nothing else is being handled. All others are left
 * to Python. The interpreter's lock is held except while waiting.
 */

#define PY_SSIZE_T_CLEAN
#include "../../native.h"
#include "receiving.h"
#include <string.h>
#include <structmember.h>

#ifndef _WIN32 /* Windows has no lanes */
#include <errno.h>
#include <sys/socket.h>
#include <unistd.h>
#include "../../turn.h"

#ifndef MSG_CMSG_CLOEXEC /* macOS, which has no lanes */
#define MSG_CMSG_CLOEXEC 0
#endif

/* bridge.hub.lane.wire: kind, number of the key, size, number, time, length of the GID, GID; then the payload */
enum { DATA = 1, SAMPLE = 42, GID = 16 };

typedef struct {
    PyObject_HEAD
    PyObject *held; /* dict */
    long long last, time_ns;
    bool known; /* whether a message was received */
} Track;

typedef struct {
    PyObject_HEAD
    PyObject *tracks; /* dict of `Track`, by GID */
    PyObject *locked; /* tuple of calls that return whether a lock is held */
    PyObject *owner, *capsule;
    const Acceptor *acceptor;
    Py_ssize_t limit;
    long long by_lane;
    char open;
} Receiver;

typedef struct {
    uint32_t number, size;
    int64_t sequence, time_ns;
    const char *gid, *payload;
} Sample;

static PyTypeObject *track_type, *receiver_type;

static uint32_t get32(const char *at)
{
    const unsigned char *bytes = (const unsigned char *)at;
    return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

static int64_t get64(const char *at)
{
    return (int64_t)(get32(at) | (uint64_t)get32(at + 4) << 32);
}

/* -- tracks -- */

static PyObject *track_sequence(PyObject *self, void *Py_UNUSED(closure))
{
    Track *track = (Track *)self;
    return track->known ? PyLong_FromLongLong(track->last) : Py_NewRef(Py_None);
}

static int set_track_sequence(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    Track *track = (Track *)self;
    if (value == NULL) {
        PyErr_SetString(PyExc_AttributeError, "sequence");
        return -1;
    }
    long long last = value == Py_None ? 0 : PyLong_AsLongLong(value);
    if (last == -1 && PyErr_Occurred()) {
        return -1;
    }
    track->last = last;
    track->known = value != Py_None;
    return 0;
}

static int track_init(PyObject *self, PyObject *Py_UNUSED(args), PyObject *Py_UNUSED(names))
{
    Track *track = (Track *)self;
    PyObject *held = PyDict_New();
    if (held == NULL) {
        return -1;
    }
    Py_XDECREF(track->held);
    track->held = held;
    return 0;
}

static int track_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((Track *)self)->held);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int track_clear(PyObject *self)
{
    Py_CLEAR(((Track *)self)->held);
    return 0;
}

static void track_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    track_clear(self);
    release(self);
}

/* -- receivers -- */

/* Returns the state of a sample's publisher if the sample is its next one, without a reference. */
static Track *next_track(Receiver *receiver, PyObject *gid, const Sample *sample)
{
    Track *track = (Track *)PyDict_GetItemWithError(receiver->tracks, gid);
    if (track == NULL || !PyObject_TypeCheck((PyObject *)track, track_type) || !track->known ||
        track->last == INT64_MAX || sample->sequence != track->last + 1 || track->held == NULL ||
        PyDict_Size(track->held) != 0) {
        return NULL;
    }
    return track;
}

static bool receive(Receiver *receiver, const Sample *sample)
{
    if (!receiver->open || receiver->acceptor == NULL || (Py_ssize_t)sample->size > receiver->limit) {
        return false;
    }
    PyObject *gid = PyBytes_FromStringAndSize(sample->gid, GID);
    Track *track = gid == NULL ? NULL : next_track(receiver, gid, sample);
    bool accepted = false;
    if (track != NULL && !is_any_locked(receiver->locked)) {
        long long time_ns = track->time_ns;
        Py_INCREF((PyObject *)track);
        track->last = sample->sequence; /* first: accepting may run other threads */
        track->time_ns = sample->time_ns;
        accepted = receiver->acceptor->accept(receiver->owner, gid, sample->payload, sample->size, sample->time_ns);
        if (accepted) {
            receiver->by_lane++;
        } else {
            track->last = sample->sequence - 1;
            track->time_ns = time_ns;
        }
        Py_DECREF((PyObject *)track);
    }
    Py_XDECREF(gid);
    PyErr_Clear(); /* Python repeats what failed */
    return accepted;
}

static PyObject *receiver_hand_to(PyObject *self, PyObject *owner)
{
    Receiver *receiver = (Receiver *)self;
    PyObject *capsule = owner == Py_None ? NULL : PyObject_GetAttrString(owner, "acceptor");
    const Acceptor *acceptor = capsule == NULL ? NULL : PyCapsule_GetPointer(capsule, ACCEPTOR);
    if (PyErr_Occurred()) {
        Py_XDECREF(capsule);
        return NULL;
    }
    PyObject *before[] = {receiver->owner, receiver->capsule};
    receiver->acceptor = acceptor;
    receiver->owner = owner == Py_None ? NULL : Py_NewRef(owner);
    receiver->capsule = capsule;
    Py_XDECREF(before[0]);
    Py_XDECREF(before[1]);
    Py_RETURN_NONE;
}

static int receiver_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Receiver *receiver = (Receiver *)self;
    PyObject *tracks, *locked;
    if (!PyArg_ParseTuple(args, "O!O!n", &PyDict_Type, &tracks, &PyTuple_Type, &locked, &receiver->limit)) {
        return -1;
    }
    Py_XDECREF(receiver->tracks);
    Py_XDECREF(receiver->locked);
    receiver->tracks = Py_NewRef(tracks);
    receiver->locked = Py_NewRef(locked);
    receiver->open = 1;
    return 0;
}

static int receiver_traverse(PyObject *self, visitproc visit, void *arg)
{
    Receiver *receiver = (Receiver *)self;
    Py_VISIT(receiver->tracks);
    Py_VISIT(receiver->locked);
    Py_VISIT(receiver->owner);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int receiver_clear(PyObject *self)
{
    Receiver *receiver = (Receiver *)self;
    receiver->open = 0;
    receiver->acceptor = NULL;
    Py_CLEAR(receiver->tracks);
    Py_CLEAR(receiver->locked);
    Py_CLEAR(receiver->owner);
    Py_CLEAR(receiver->capsule);
    return 0;
}

static void receiver_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    receiver_clear(self);
    release(self);
}

/* -- reading -- */

static bool receive_by_number(PyObject *receivers, const Sample *sample)
{
    PyObject *number = PyLong_FromUnsignedLong(sample->number);
    PyObject *receiver = number == NULL ? NULL : PyDict_GetItemWithError(receivers, number);
    Py_XDECREF(number);
    PyErr_Clear();
    if (receiver == NULL || !PyObject_TypeCheck(receiver, receiver_type)) {
        return false;
    }
    Py_INCREF(receiver);
    bool received = receive((Receiver *)receiver, sample);
    Py_DECREF(receiver);
    return received;
}

/* Hands over the messages of a record; returns -1 with an exception. */
static int handle_messages(const char *record, size_t length, PyObject *receivers, PyObject *message)
{
    int64_t begun = milliseconds();
    for (size_t at = 0; at < length;) {
        give_turn(&begun);
        Sample sample = {0};
        if (length - at >= SAMPLE) {
            const char *head = record + at;
            sample = (Sample){get32(head + 1), get32(head + 5), get64(head + 9), get64(head + 17), head + 26, head + SAMPLE};
        }
        if (length - at < SAMPLE || length - at - SAMPLE < sample.size) {
            PyErr_Format(PyExc_ValueError, "a record of %zu bytes ends within a message", length);
            return -1;
        }
        at += SAMPLE + sample.size;
        if (receive_by_number(receivers, &sample)) {
            continue;
        }
        PyObject *done =
            PyObject_CallFunction(message, "I(LLy#)y#", sample.number, (long long)sample.sequence,
                                  (long long)sample.time_ns, sample.gid, (Py_ssize_t)GID, sample.payload,
                                  (Py_ssize_t)sample.size);
        if (done == NULL) {
            return -1;
        }
        Py_DECREF(done);
    }
    return 0;
}

/* Receives a record, and the file that came with it, else -1. */
static ssize_t receive_record(int socket, char *buffer, size_t room, int *file)
{
    union {
        struct cmsghdr head;
        char room[CMSG_SPACE(sizeof(int))];
    } control;
    struct iovec into = {buffer, room};
    struct msghdr message;
    ssize_t length;
    Py_BEGIN_ALLOW_THREADS
    do {
        message = (struct msghdr){.msg_iov = &into, .msg_iovlen = 1, .msg_control = &control};
        message.msg_controllen = CMSG_LEN(sizeof(int)); /* for one file; the system closes further ones */
        length = recvmsg(socket, &message, MSG_CMSG_CLOEXEC);
    } while (length < 0 && errno == EINTR);
    Py_END_ALLOW_THREADS
    const struct cmsghdr *head = length < 0 ? NULL : CMSG_FIRSTHDR(&message);
    *file = -1;
    if (head != NULL && head->cmsg_level == SOL_SOCKET && head->cmsg_type == SCM_RIGHTS) {
        memcpy(file, CMSG_DATA(head), sizeof *file);
    }
    return length;
}

static int read_records(int socket, char *buffer, size_t room, PyObject *receivers, PyObject *message, PyObject *other)
{
    ssize_t length;
    int file;
    while ((length = receive_record(socket, buffer, room, &file)) > 0) {
        if (buffer[0] == DATA && file < 0) {
            if (handle_messages(buffer, (size_t)length, receivers, message) < 0) {
                return -1;
            }
            continue;
        }
        PyObject *done = PyObject_CallFunction(other, "y#i", buffer, (Py_ssize_t)length, file);
        if (done == NULL) {
            return -1;
        }
        Py_DECREF(done);
    }
    if (length < 0) {
        PyErr_SetFromErrno(PyExc_OSError);
    } else if (file >= 0) {
        close(file);
    }
    return (int)length;
}

static PyObject *read_lane(PyObject *Py_UNUSED(module), PyObject *args)
{
    int socket;
    Py_ssize_t room;
    PyObject *receivers, *message, *other;
    if (!PyArg_ParseTuple(args, "inO!OO", &socket, &room, &PyDict_Type, &receivers, &message, &other)) {
        return NULL;
    }
    char *buffer = PyMem_Malloc((size_t)room);
    if (buffer == NULL) {
        return PyErr_NoMemory();
    }
    int failed = read_records(socket, buffer, (size_t)room, receivers, message, other);
    PyMem_Free(buffer);
    return failed < 0 ? NULL : Py_NewRef(Py_None);
}

/* -- the module -- */

static PyMemberDef track_members[] = {
    {"time_ns", T_LONGLONG, offsetof(Track, time_ns), 0, NULL},
    {"held", T_OBJECT_EX, offsetof(Track, held), READONLY, NULL},
    {NULL},
};
static PyGetSetDef track_getters[] = {{"sequence", track_sequence, set_track_sequence, NULL, NULL}, {NULL}};
static PyType_Slot track_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, track_init}, {Py_tp_dealloc, track_dealloc},
    {Py_tp_traverse, track_traverse}, {Py_tp_clear, track_clear}, {Py_tp_members, track_members},
    {Py_tp_getset, track_getters}, {0, NULL},
};
static PyType_Spec track_spec = {
    "bridge.hub.lane.receiving.Track", sizeof(Track), 0,
    Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_HAVE_GC, track_slots,
};

static PyMemberDef receiver_members[] = {
    {"open", T_BOOL, offsetof(Receiver, open), 0, NULL},
    {"by_lane", T_LONGLONG, offsetof(Receiver, by_lane), READONLY, NULL},
    {NULL},
};
static PyMethodDef receiver_methods[] = {
    {"hand_to", receiver_hand_to, METH_O, "Hand the messages over to an object with an `acceptor`, or to Python (None)."},
    {NULL, NULL, 0, NULL},
};
static PyType_Slot receiver_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, receiver_init}, {Py_tp_dealloc, receiver_dealloc},
    {Py_tp_traverse, receiver_traverse}, {Py_tp_clear, receiver_clear}, {Py_tp_methods, receiver_methods},
    {Py_tp_members, receiver_members}, {0, NULL},
};
static PyType_Spec receiver_spec = {
    "bridge.hub.lane.receiving.Receiver", sizeof(Receiver), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, receiver_slots,
};

static PyMethodDef methods[] = {
    {"read_lane", read_lane, METH_VARARGS,
     "Read a socket until its end; call back with the messages that no receiver takes, and with other records and files."},
    {NULL, NULL, 0, NULL},
};

static int add_types(PyObject *module)
{
    track_type = (PyTypeObject *)PyType_FromSpec(&track_spec);
    receiver_type = (PyTypeObject *)PyType_FromSpec(&receiver_spec);
    bool made = track_type != NULL && receiver_type != NULL &&
                PyModule_AddObjectRef(module, "Track", (PyObject *)track_type) == 0 &&
                PyModule_AddObjectRef(module, "Receiver", (PyObject *)receiver_type) == 0;
    return made ? 0 : -1;
}

#else

static PyMethodDef methods[] = {{NULL, NULL, 0, NULL}};

static int add_types(PyObject *Py_UNUSED(module))
{
    return 0;
}

#endif

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "receiving", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_receiving(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made != NULL && add_types(made) < 0) {
        Py_CLEAR(made);
    }
    return made;
}

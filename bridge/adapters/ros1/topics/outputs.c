/* Writes small messages to the sockets of a topic's subscribers without the interpreter.
 *
 * Everything runs while the interpreter's lock is held. A socket that accepts only a part of a message keeps the rest for
 * Python, which is called to send it.
 */

#define PY_SSIZE_T_CLEAN
#include "../../../native.h"
#include "../../../routing/output.h"
#include <stdint.h>
#include <structmember.h>

#ifndef _WIN32
#include <errno.h>
#include <sys/socket.h>

#ifndef MSG_NOSIGNAL
#define MSG_NOSIGNAL 0
#endif

typedef struct {
    PyObject_HEAD
    PyObject *locked; /* tuple of the call that returns whether the connection's lock is held */
    PyObject *resume; /* called after a message was cut, or the connection has failed */
    PyObject *rest;   /* what is left of a message; NULL: nothing */
    int descriptor;
    char free, failed, due; /* due: `resume` has to be called */
    long long messages, bytes;
} Socket;

typedef struct {
    PyObject_HEAD
    PyObject *locked;  /* tuple of the call that returns whether the topic's lock is held */
    PyObject *sockets; /* tuple of `Socket` */
    long long bytes;
    char open;
} Outputs;

static PyTypeObject *socket_type;

/* -- sockets -- */

/* Returns whether Python has to continue. */
static bool write_frame(Socket *socket, const char *frame, size_t size)
{
    ssize_t sent = send(socket->descriptor, frame, size, MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent == (ssize_t)size) {
        socket->messages++;
        socket->bytes += sent;
        return false;
    }
    socket->free = 0;
    socket->failed = sent < 0 && errno != EAGAIN && errno != EINTR;
    sent = sent < 0 ? 0 : sent;
    socket->bytes += sent;
    if (!socket->failed) {
        Py_XDECREF(socket->rest);
        socket->rest = PyBytes_FromStringAndSize(frame + sent, (Py_ssize_t)size - sent);
        socket->failed = socket->rest == NULL; /* no memory: a cut message would make the next ones unreadable */
    }
    PyErr_Clear();
    return true;
}

static PyObject *socket_take(PyObject *self, PyObject *Py_UNUSED(unused))
{
    PyObject *rest = ((Socket *)self)->rest;
    ((Socket *)self)->rest = NULL;
    return rest != NULL ? rest : PyBytes_FromStringAndSize("", 0);
}

static PyObject *socket_cut(PyObject *self, void *Py_UNUSED(closure))
{
    return PyBool_FromLong(((Socket *)self)->rest != NULL);
}

static int socket_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Socket *socket = (Socket *)self;
    PyObject *locked, *resume;
    if (!PyArg_ParseTuple(args, "iO!O", &socket->descriptor, &PyTuple_Type, &locked, &resume)) {
        return -1;
    }
    Py_XDECREF(socket->locked);
    Py_XDECREF(socket->resume);
    socket->locked = Py_NewRef(locked);
    socket->resume = Py_NewRef(resume);
    socket->free = 1;
    return 0;
}

static int socket_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((Socket *)self)->locked);
    Py_VISIT(((Socket *)self)->resume);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int socket_clear(PyObject *self)
{
    ((Socket *)self)->free = 0;
    Py_CLEAR(((Socket *)self)->locked);
    Py_CLEAR(((Socket *)self)->resume);
    return 0;
}

static void socket_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    socket_clear(self);
    Py_XDECREF(((Socket *)self)->rest);
    release(self);
}

/* -- outputs -- */

static bool is_ready(PyObject *self)
{
    Outputs *outputs = (Outputs *)self;
    bool ready = outputs->open && !is_any_locked(outputs->locked);
    for (Py_ssize_t at = 0; ready && at < PyTuple_Size(outputs->sockets); at++) {
        Socket *socket = (Socket *)PyTuple_GetItem(outputs->sockets, at);
        ready = socket->free && !is_any_locked(socket->locked);
    }
    PyErr_Clear(); /* of a call, which then counts as locked */
    return ready;
}

static bool send_message(PyObject *self, char *message, size_t size)
{
    Outputs *outputs = (Outputs *)self;
    PyObject *sockets = Py_NewRef(outputs->sockets);
    bool due = false;
    char *frame = message - PREFIX;
    for (int byte = 0; byte < PREFIX; byte++) {
        frame[byte] = (char)(size >> (8 * byte));
    }
    outputs->bytes += (long long)size;
    for (Py_ssize_t at = 0; at < PyTuple_Size(sockets); at++) {
        Socket *socket = (Socket *)PyTuple_GetItem(sockets, at);
        socket->due = write_frame(socket, frame, size + PREFIX);
        due = due || socket->due;
    }
    /* Last, because these run Python. Until then no object may be created that the collector tracks: it would run too. */
    for (Py_ssize_t at = 0; due && at < PyTuple_Size(sockets); at++) {
        Socket *socket = (Socket *)PyTuple_GetItem(sockets, at);
        PyObject *resume = socket->due ? Py_XNewRef(socket->resume) : NULL;
        socket->due = 0;
        PyObject *done = resume == NULL ? NULL : PyObject_CallNoArgs(resume);
        if (PyErr_Occurred()) {
            PyErr_WriteUnraisable(resume);
        }
        Py_XDECREF(done);
        Py_XDECREF(resume);
    }
    Py_DECREF(sockets);
    return true;
}

static PyObject *outputs_set(PyObject *self, PyObject *sockets)
{
    Outputs *outputs = (Outputs *)self;
    for (Py_ssize_t at = 0; at < PyTuple_Size(sockets); at++) {
        if (!PyObject_TypeCheck(PyTuple_GetItem(sockets, at), socket_type)) {
            PyErr_SetString(PyExc_TypeError, "outputs consist of sockets");
        }
    }
    if (PyErr_Occurred()) {
        return NULL;
    }
    PyObject *before = outputs->sockets;
    outputs->sockets = Py_NewRef(sockets);
    Py_XDECREF(before);
    Py_RETURN_NONE;
}

static PyObject *outputs_output(PyObject *Py_UNUSED(self), void *Py_UNUSED(closure))
{
    static const Output output = {is_ready, send_message};
    return PyCapsule_New((void *)&output, OUTPUT, NULL);
}

static int outputs_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Outputs *outputs = (Outputs *)self;
    PyObject *locked;
    if (!PyArg_ParseTuple(args, "O!", &PyTuple_Type, &locked)) {
        return -1;
    }
    Py_XDECREF(outputs->locked);
    Py_XDECREF(outputs->sockets);
    outputs->locked = Py_NewRef(locked);
    outputs->sockets = PyTuple_New(0);
    outputs->open = 1;
    return outputs->sockets == NULL ? -1 : 0;
}

static int outputs_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((Outputs *)self)->locked);
    Py_VISIT(((Outputs *)self)->sockets);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int outputs_clear(PyObject *self)
{
    ((Outputs *)self)->open = 0;
    Py_CLEAR(((Outputs *)self)->locked);
    Py_CLEAR(((Outputs *)self)->sockets);
    return 0;
}

static void outputs_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    outputs_clear(self);
    release(self);
}

/* -- the module -- */

static PyMemberDef socket_members[] = {
    {"free", T_BOOL, offsetof(Socket, free), 0, NULL},
    {"failed", T_BOOL, offsetof(Socket, failed), READONLY, NULL},
    {"messages", T_LONGLONG, offsetof(Socket, messages), READONLY, NULL},
    {"bytes", T_LONGLONG, offsetof(Socket, bytes), READONLY, NULL},
    {NULL},
};
static PyGetSetDef socket_getters[] = {{"cut", socket_cut, NULL, NULL, NULL}, {NULL}};
static PyMethodDef socket_methods[] = {
    {"take", socket_take, METH_NOARGS, "Return the rest of a message that was cut."}, {NULL, NULL, 0, NULL},
};
static PyType_Slot socket_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, socket_init}, {Py_tp_dealloc, socket_dealloc},
    {Py_tp_traverse, socket_traverse}, {Py_tp_clear, socket_clear}, {Py_tp_methods, socket_methods},
    {Py_tp_members, socket_members}, {Py_tp_getset, socket_getters}, {0, NULL},
};
static PyType_Spec socket_spec = {
    "bridge.adapters.ros1.topics.outputs.Socket", sizeof(Socket), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    socket_slots,
};

static PyMemberDef outputs_members[] = {
    {"open", T_BOOL, offsetof(Outputs, open), 0, NULL},
    {"bytes", T_LONGLONG, offsetof(Outputs, bytes), READONLY, NULL},
    {NULL},
};
static PyGetSetDef outputs_getters[] = {{"output", outputs_output, NULL, NULL, NULL}, {NULL}};
static PyMethodDef outputs_methods[] = {
    {"set", outputs_set, METH_O, "Set the sockets of all subscribers."}, {NULL, NULL, 0, NULL},
};
static PyType_Slot outputs_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, outputs_init}, {Py_tp_dealloc, outputs_dealloc},
    {Py_tp_traverse, outputs_traverse}, {Py_tp_clear, outputs_clear}, {Py_tp_methods, outputs_methods},
    {Py_tp_members, outputs_members}, {Py_tp_getset, outputs_getters}, {0, NULL},
};
static PyType_Spec outputs_spec = {
    "bridge.adapters.ros1.topics.outputs.Outputs", sizeof(Outputs), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    outputs_slots,
};

static int add_types(PyObject *module)
{
    socket_type = (PyTypeObject *)PyType_FromSpec(&socket_spec);
    PyObject *outputs_type = PyType_FromSpec(&outputs_spec);
    int failed = socket_type == NULL || outputs_type == NULL ||
                 PyModule_AddObjectRef(module, "Socket", (PyObject *)socket_type) < 0 ||
                 PyModule_AddObjectRef(module, "Outputs", outputs_type) < 0;
    Py_XDECREF(outputs_type);
    return failed ? -1 : 0;
}

#else

static int add_types(PyObject *Py_UNUSED(module))
{
    return 0;
}

#endif

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "outputs", .m_size = -1};

PyMODINIT_FUNC PyInit_outputs(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made != NULL && add_types(made) < 0) {
        Py_CLEAR(made);
    }
    return made;
}

/* The way of a small message into the hub without the interpreter: the checks of a route, its conversion and counters.
 *
 * A route admits its plain publishers to its doorway. Everything runs while the interpreter's lock is held. A message
 * that is not plain (a held message, an expired lease, a failing conversion, ...) is left to the route's `deliver`.
 */

#define PY_SSIZE_T_CLEAN
#include "../hub/lane/links.h"
#include "../native.h"
#include "output.h"
#include <structmember.h>

#ifndef _WIN32 /* Windows has no lanes */
#include "../messages/transcode/program.h"

enum { MAX_BOUNDS = 15 };

typedef struct {
    PyObject_HEAD
    PyObject *deliver, *hold, *held, *senders, *native;
    Deadline *lease;
    Program program;
    Py_ssize_t limit;
    char open, releasing;
    long long messages, bytes;
    double last, carrying;
    int bounds;
    double bound[MAX_BOUNDS];
    long long carried[MAX_BOUNDS + 1];
} Doorway;

static PyTypeObject *deadline_type;
static const LinksApi *links;

static void count(Doorway *doorway, int64_t size, double since)
{
    double now = monotonic();
    int bucket = 0;
    while (bucket < doorway->bounds && doorway->bound[bucket] < now - since) {
        bucket++;
    }
    doorway->carried[bucket]++;
    doorway->carrying += now - since;
    doorway->messages++;
    doorway->bytes += size;
    doorway->last = now;
}

/* Returns the sender of a source if nothing prevents its messages from being sent now. */
static PyObject *ready_sender(Doorway *doorway, PyObject *source, double now)
{
    if (!doorway->open || doorway->releasing || now > doorway->lease->until || PyObject_Size(doorway->held) != 0 ||
        is_held(doorway->hold)) {
        return NULL;
    }
    PyObject *sender = PyDict_GetItemWithError(doorway->senders, source);
    return sender != NULL && links->is_ready(sender) ? sender : NULL;
}

static void write_message(void *message, char *place)
{
    (void)write_converted(message, place); /* bytes of Python, which do not change */
}

/* Sends a message, and returns true; or returns false, and has done nothing. */
static bool send_message(Doorway *doorway, PyObject *payload, PyObject *source, PyObject *time)
{
    double since = monotonic();
    Message message = {
        &doorway->program, (const unsigned char *)PyBytes_AsString(payload), PyBytes_Size(payload), 0, false,
    };
    PyObject *sender = message.size > doorway->limit ? NULL : ready_sender(doorway, source, since);
    if (sender == NULL || !measure(&message) || message.converted > doorway->limit) {
        return false;
    }
    int64_t time_ns = time == Py_None ? nanoseconds(CLOCK_REALTIME) : PyLong_AsLongLong(time);
    if (time_ns == -1 && PyErr_Occurred()) {
        return false;
    }
    Py_INCREF(sender);
    links->send(sender, time_ns, (size_t)message.converted, write_message, &message);
    Py_DECREF(sender);
    count(doorway, message.converted, since);
    return true;
}

static PyObject *doorway_call(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Doorway *doorway = (Doorway *)self;
    PyObject *payload, *source, *time;
    if (!PyArg_UnpackTuple(args, "deliver", 3, 3, &payload, &source, &time)) {
        return NULL;
    }
    if (doorway->deliver == NULL) {
        PyErr_SetString(PyExc_RuntimeError, "the doorway is not initialized, or was cleared");
        return NULL;
    }
    bool plain = PyBytes_CheckExact(payload) && (time == Py_None || PyLong_CheckExact(time));
    if (plain && send_message(doorway, payload, source, time)) {
        Py_RETURN_NONE;
    }
    return PyErr_Occurred() ? NULL : PyObject_CallObject(doorway->deliver, args);
}

static PyObject *doorway_carried(PyObject *self, void *Py_UNUSED(closure))
{
    Doorway *doorway = (Doorway *)self;
    PyObject *list = PyList_New(doorway->bounds + 1);
    for (int at = 0; list != NULL && at <= doorway->bounds; at++) {
        PyObject *number = PyLong_FromLongLong(doorway->carried[at]);
        if (number == NULL || PyList_SetItem(list, at, number) < 0) {
            Py_CLEAR(list);
        }
    }
    return list;
}

static int doorway_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Doorway *doorway = (Doorway *)self;
    PyObject *deliver, *lease, *hold, *held, *native, *bounds;
    Py_ssize_t limit;
    if (!PyArg_ParseTuple(args, "OO!OOOnO!", &deliver, deadline_type, &lease, &hold, &held, &native, &limit,
                          &PyTuple_Type, &bounds)) {
        return -1;
    }
    if (PyTuple_Size(bounds) > MAX_BOUNDS || doorway->deliver != NULL) {
        PyErr_SetString(PyExc_ValueError, "a route has one doorway, with at most 15 bounds");
        return -1;
    }
    for (Py_ssize_t at = 0; at < PyTuple_Size(bounds); at++) {
        doorway->bound[at] = PyFloat_AsDouble(PyTuple_GetItem(bounds, at));
    }
    doorway->bounds = (int)PyTuple_Size(bounds);
    doorway->senders = PyDict_New();
    if (PyErr_Occurred() || set_program(&doorway->program, native) < 0) {
        return -1;
    }
    doorway->deliver = Py_NewRef(deliver);
    doorway->hold = Py_NewRef(hold);
    doorway->held = Py_NewRef(held);
    doorway->native = Py_NewRef(native);
    doorway->lease = (Deadline *)Py_NewRef(lease);
    doorway->limit = limit < MAX_JOINED_BYTES ? limit : MAX_JOINED_BYTES;
    doorway->open = 1;
    return 0;
}

static PyObject *doorway_admit(PyObject *self, PyObject *args)
{
    PyObject *source, *sender;
    Doorway *doorway = (Doorway *)self;
    if (!PyArg_ParseTuple(args, "OO!", &source, links->sender_type, &sender) ||
        (doorway->senders != NULL && PyDict_SetItem(doorway->senders, source, sender) < 0)) {
        return NULL;
    }
    Py_RETURN_NONE;
}

static PyObject *doorway_dismiss(PyObject *self, PyObject *source)
{
    PyObject *senders = ((Doorway *)self)->senders;
    if (senders != NULL && PyDict_GetItemWithError(senders, source) != NULL) {
        PyDict_DelItem(senders, source);
    }
    return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
}

static int doorway_traverse(PyObject *self, visitproc visit, void *arg)
{
    Doorway *doorway = (Doorway *)self;
    Py_VISIT(doorway->deliver);
    Py_VISIT((PyObject *)doorway->lease);
    Py_VISIT(doorway->hold);
    Py_VISIT(doorway->held);
    Py_VISIT(doorway->senders);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int doorway_clear(PyObject *self)
{
    Doorway *doorway = (Doorway *)self;
    doorway->open = 0;
    Py_CLEAR(doorway->deliver);
    Py_CLEAR(doorway->lease);
    Py_CLEAR(doorway->hold);
    Py_CLEAR(doorway->held);
    Py_CLEAR(doorway->senders);
    return 0;
}

static void doorway_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    doorway_clear(self);
    Py_XDECREF(((Doorway *)self)->native);
    release(self);
}

/* -- the module -- */

static PyMemberDef deadline_members[] = {{"until", T_DOUBLE, offsetof(Deadline, until), 0, NULL}, {NULL}};
static PyType_Slot deadline_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_dealloc, release}, {Py_tp_members, deadline_members}, {0, NULL},
};
static PyType_Spec deadline_spec = {
    "bridge.routing.doorway.Deadline", sizeof(Deadline), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE, deadline_slots,
};

static PyMemberDef doorway_members[] = {
    {"open", T_BOOL, offsetof(Doorway, open), 0, NULL},
    {"releasing", T_BOOL, offsetof(Doorway, releasing), 0, NULL},
    {"messages", T_LONGLONG, offsetof(Doorway, messages), READONLY, NULL},
    {"bytes", T_LONGLONG, offsetof(Doorway, bytes), READONLY, NULL},
    {"last", T_DOUBLE, offsetof(Doorway, last), READONLY, NULL},
    {"carrying", T_DOUBLE, offsetof(Doorway, carrying), READONLY, NULL},
    {NULL},
};
static PyGetSetDef doorway_getters[] = {{"carried", doorway_carried, NULL, NULL, NULL}, {NULL}};
static PyMethodDef doorway_methods[] = {
    {"admit", doorway_admit, METH_VARARGS, "Send the messages of a source by a sender, while nothing prevents it."},
    {"dismiss", doorway_dismiss, METH_O, "Leave the messages of a source to the route again."},
    {NULL, NULL, 0, NULL},
};
static PyType_Slot doorway_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, doorway_init}, {Py_tp_dealloc, doorway_dealloc},
    {Py_tp_traverse, doorway_traverse}, {Py_tp_clear, doorway_clear}, {Py_tp_call, doorway_call},
    {Py_tp_methods, doorway_methods}, {Py_tp_members, doorway_members}, {Py_tp_getset, doorway_getters}, {0, NULL},
};
static PyType_Spec doorway_spec = {
    "bridge.routing.doorway.Doorway", sizeof(Doorway), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, doorway_slots,
};

static int add_types(PyObject *module)
{
    PyObject *owner = PyImport_ImportModule("bridge.hub.lane.links"); /* it has the capsule */
    PyObject *capsule = owner == NULL ? NULL : PyObject_GetAttrString(owner, "api");
    links = capsule == NULL ? NULL : PyCapsule_GetPointer(capsule, LINKS_API);
    Py_XDECREF(capsule);
    Py_XDECREF(owner);
    deadline_type = links == NULL ? NULL : (PyTypeObject *)PyType_FromSpec(&deadline_spec);
    PyObject *doorway_type = deadline_type == NULL ? NULL : PyType_FromSpec(&doorway_spec);
    int failed = doorway_type == NULL || PyModule_AddObjectRef(module, "Deadline", (PyObject *)deadline_type) < 0 ||
                 PyModule_AddObjectRef(module, "Doorway", doorway_type) < 0;
    Py_XDECREF(doorway_type);
    return failed ? -1 : 0;
}

#else

static int add_types(PyObject *Py_UNUSED(module))
{
    return 0;
}

#endif

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "doorway", .m_size = -1};

PyMODINIT_FUNC PyInit_doorway(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made != NULL && add_types(made) < 0) {
        Py_CLEAR(made);
    }
    return made;
}

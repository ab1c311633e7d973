/* The way of a small message from the hub to a side without the interpreter: the checks of a route, its conversion and
 * counters, and the side's output.
 *
 * Everything runs while the interpreter's lock is held. A message that is not plain (of a latched or unknown publisher,
 * without the lease, behind a queued message, ...) is left to Python.
 */

#define PY_SSIZE_T_CLEAN
#include "../hub/lane/receiving.h"
#include "../native.h"
#include "output.h"
#include <structmember.h>

#ifndef _WIN32 /* Windows has no lanes */
#include "../messages/transcode/program.h"

enum { LATENCIES = 512, MAX_BOUNDS = 15, MAX_SIZE = 64 * 1024 };

typedef struct {
    PyObject_HEAD
    Deadline *lease;
    PyObject *hold;    /* has the attribute `held`; or None */
    PyObject *waiting; /* tuple of deques that have to be empty */
    PyObject *locked;  /* tuple of calls that return whether a lock is held */
    PyObject *allowed; /* container of GIDs with plain messages */
    PyObject *native;
    Program program;
    Py_ssize_t limit;
    PyObject *owner, *capsule; /* of the output */
    const Output *output;
    double since; /* latencies of older messages are not counted */
    long long messages, bytes, measured, waited;
    double last;
    int bounds;
    long long bound[MAX_BOUNDS], buckets[MAX_BOUNDS + 1];
    long long latencies[LATENCIES];
    char open;
} Exit;

static char buffer[PREFIX + MAX_SIZE]; /* guarded by the interpreter's lock */

static void add(Exit *way, int64_t latency)
{
    int bucket = 0;
    while (bucket < way->bounds && way->bound[bucket] < latency) {
        bucket++;
    }
    way->buckets[bucket]++;
    way->latencies[way->measured++ % LATENCIES] = latency;
    way->waited += latency > 0 ? latency : 0;
}

static void count(Exit *way, int64_t size, int64_t time_ns)
{
    double now = monotonic();
    int64_t clock = nanoseconds(CLOCK_REALTIME);
    int64_t latency = time_ns < 0 ? clock : clock - time_ns; /* no stamp is older than the clock's zero */
    if (now - 1e-9 * (double)latency >= way->since) {
        add(way, latency);
    }
    way->messages++;
    way->bytes += size;
    way->last = now;
}

static bool is_plain(Exit *way, PyObject *gid)
{
    if (!way->open || way->output == NULL || PySequence_Contains(way->allowed, gid) != 1 ||
        monotonic() > way->lease->until || is_held(way->hold)) {
        return false;
    }
    for (Py_ssize_t at = 0; at < PyTuple_Size(way->waiting); at++) {
        if (PyObject_Size(PyTuple_GetItem(way->waiting, at)) != 0) {
            return false;
        }
    }
    return !is_any_locked(way->locked) && way->output->is_ready(way->owner);
}

static bool accept(PyObject *self, PyObject *gid, const char *payload, size_t size, int64_t time_ns)
{
    Exit *way = (Exit *)self;
    Message message = {&way->program, (const unsigned char *)payload, (int64_t)size, 0, false};
    if (!is_plain(way, gid) || !measure(&message) || message.converted > way->limit ||
        !write_converted(&message, buffer + PREFIX)) {
        return false;
    }
    Py_INCREF(self);
    bool sent = way->output->send(way->owner, buffer + PREFIX, (size_t)message.converted);
    if (sent) {
        count(way, message.converted, time_ns);
    }
    Py_DECREF(self);
    return sent;
}

static PyObject *exit_send_by(PyObject *self, PyObject *owner)
{
    Exit *way = (Exit *)self;
    PyObject *capsule = owner == Py_None ? NULL : PyObject_GetAttrString(owner, "output");
    const Output *output = capsule == NULL ? NULL : PyCapsule_GetPointer(capsule, OUTPUT);
    if (PyErr_Occurred()) {
        Py_XDECREF(capsule);
        return NULL;
    }
    PyObject *before[] = {way->owner, way->capsule};
    way->output = output;
    way->owner = owner == Py_None ? NULL : Py_NewRef(owner);
    way->capsule = capsule;
    Py_XDECREF(before[0]);
    Py_XDECREF(before[1]);
    Py_RETURN_NONE;
}

static PyObject *exit_allow(PyObject *self, PyObject *gids)
{
    PyObject *before = ((Exit *)self)->allowed;
    ((Exit *)self)->allowed = Py_NewRef(gids);
    Py_XDECREF(before);
    Py_RETURN_NONE;
}

static PyObject *exit_add_latency(PyObject *self, PyObject *nanoseconds)
{
    long long latency = PyLong_AsLongLong(nanoseconds);
    if (latency == -1 && PyErr_Occurred()) {
        return NULL;
    }
    add((Exit *)self, latency);
    Py_RETURN_NONE;
}

static PyObject *numbers(const long long *values, Py_ssize_t count)
{
    PyObject *list = PyList_New(count);
    for (Py_ssize_t at = 0; list != NULL && at < count; at++) {
        PyObject *number = PyLong_FromLongLong(values[at]);
        if (number == NULL || PyList_SetItem(list, at, number) < 0) {
            Py_CLEAR(list);
        }
    }
    return list;
}

static PyObject *exit_buckets(PyObject *self, void *Py_UNUSED(closure))
{
    return numbers(((Exit *)self)->buckets, ((Exit *)self)->bounds + 1);
}

static PyObject *exit_latencies(PyObject *self, void *Py_UNUSED(closure))
{
    Exit *way = (Exit *)self;
    return numbers(way->latencies, way->measured < LATENCIES ? (Py_ssize_t)way->measured : LATENCIES);
}

static PyObject *exit_acceptor(PyObject *Py_UNUSED(self), void *Py_UNUSED(closure))
{
    static const Acceptor acceptor = {accept};
    return PyCapsule_New((void *)&acceptor, ACCEPTOR, NULL);
}

static int set_bounds(Exit *way, PyObject *bounds)
{
    if (PyTuple_Size(bounds) > MAX_BOUNDS) {
        PyErr_SetString(PyExc_ValueError, "a route has at most 15 bounds");
        return -1;
    }
    way->bounds = (int)PyTuple_Size(bounds);
    for (int at = 0; at < way->bounds; at++) {
        way->bound[at] = PyLong_AsLongLong(PyTuple_GetItem(bounds, at));
    }
    return PyErr_Occurred() ? -1 : 0;
}

static int exit_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Exit *way = (Exit *)self;
    PyObject *owner = PyImport_ImportModule("bridge.routing.doorway");
    PyObject *deadline = owner == NULL ? NULL : PyObject_GetAttrString(owner, "Deadline");
    PyObject *lease, *hold, *waiting, *locked, *native, *bounds;
    Py_ssize_t limit;
    bool valid = deadline != NULL &&
                 PyArg_ParseTuple(args, "O!OO!O!OnO!", deadline, &lease, &hold, &PyTuple_Type, &waiting, &PyTuple_Type,
                                  &locked, &native, &limit, &PyTuple_Type, &bounds);
    Py_XDECREF(deadline);
    Py_XDECREF(owner);
    if (!valid || way->lease != NULL || set_bounds(way, bounds) < 0 || set_program(&way->program, native) < 0) {
        if (!PyErr_Occurred()) {
            PyErr_SetString(PyExc_ValueError, "a route has one exit");
        }
        return -1;
    }
    way->allowed = PyFrozenSet_New(NULL);
    way->lease = (Deadline *)Py_NewRef(lease);
    way->hold = Py_NewRef(hold);
    way->waiting = Py_NewRef(waiting);
    way->locked = Py_NewRef(locked);
    way->native = Py_NewRef(native);
    way->limit = limit < MAX_SIZE ? limit : MAX_SIZE;
    way->open = 1;
    return way->allowed == NULL ? -1 : 0;
}

static int exit_traverse(PyObject *self, visitproc visit, void *arg)
{
    Exit *way = (Exit *)self;
    Py_VISIT((PyObject *)way->lease);
    Py_VISIT(way->hold);
    Py_VISIT(way->waiting);
    Py_VISIT(way->locked);
    Py_VISIT(way->allowed);
    Py_VISIT(way->owner);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int exit_clear(PyObject *self)
{
    Exit *way = (Exit *)self;
    way->open = 0;
    way->output = NULL;
    Py_CLEAR(way->lease);
    Py_CLEAR(way->hold);
    Py_CLEAR(way->waiting);
    Py_CLEAR(way->locked);
    Py_CLEAR(way->allowed);
    Py_CLEAR(way->owner);
    Py_CLEAR(way->capsule);
    return 0;
}

static void exit_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    exit_clear(self);
    Py_XDECREF(((Exit *)self)->native);
    release(self);
}

static PyMemberDef exit_members[] = {
    {"open", T_BOOL, offsetof(Exit, open), 0, NULL},
    {"since", T_DOUBLE, offsetof(Exit, since), 0, NULL},
    {"messages", T_LONGLONG, offsetof(Exit, messages), READONLY, NULL},
    {"bytes", T_LONGLONG, offsetof(Exit, bytes), READONLY, NULL},
    {"waited", T_LONGLONG, offsetof(Exit, waited), READONLY, NULL},
    {"last", T_DOUBLE, offsetof(Exit, last), READONLY, NULL},
    {NULL},
};
static PyGetSetDef exit_getters[] = {
    {"buckets", exit_buckets, NULL, NULL, NULL},
    {"latencies", exit_latencies, NULL, NULL, NULL},
    {"acceptor", exit_acceptor, NULL, NULL, NULL},
    {NULL},
};
static PyMethodDef exit_methods[] = {
    {"send_by", exit_send_by, METH_O, "Send by an object with an `output`, or leave all messages to Python (None)."},
    {"add_latency", exit_add_latency, METH_O, "Count the latency in ns of a message that Python has sent."},
    {"allow", exit_allow, METH_O, "Set the GIDs of the publishers whose messages are plain."},
    {NULL, NULL, 0, NULL},
};
static PyType_Slot exit_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, exit_init}, {Py_tp_dealloc, exit_dealloc},
    {Py_tp_traverse, exit_traverse}, {Py_tp_clear, exit_clear}, {Py_tp_methods, exit_methods},
    {Py_tp_members, exit_members}, {Py_tp_getset, exit_getters}, {0, NULL},
};
static PyType_Spec exit_spec = {
    "bridge.routing.exit.Exit", sizeof(Exit), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, exit_slots,
};

static int add_types(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&exit_spec);
    int failed = type == NULL ? -1 : PyModule_AddObjectRef(module, "Exit", type);
    Py_XDECREF(type);
    return failed;
}

#else

static int add_types(PyObject *Py_UNUSED(module))
{
    return 0;
}

#endif

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "exit", .m_size = -1};

PyMODINIT_FUNC PyInit_exit(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made != NULL && add_types(made) < 0) {
        Py_CLEAR(made);
    }
    return made;
}

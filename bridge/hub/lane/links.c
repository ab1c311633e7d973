/* Sends small messages on the lanes without the interpreter, several in one record where a thread joins them.
 *
 * Everything runs while the interpreter's lock is held, so that no other thread sees a half-sent message. A message that
 * is not plain (a full socket, a subscriber on zenoh, ...) takes the path in Python.
 */

#define PY_SSIZE_T_CLEAN
#include "../../native.h"
#include "links.h"
#include <string.h>
#include <structmember.h>

#ifndef _WIN32 /* Windows has no lanes */
#include <sys/socket.h>

#ifndef MSG_NOSIGNAL
#define MSG_NOSIGNAL 0
#endif

/* bridge.hub.lane.wire: kind, number of the key, size, number, time, length of the GID, GID; then the payload */
enum { DATA = 1, SAMPLE = 42, GID = 16, ATTACHMENT = 33 };
enum { MAX_JOINED = 8, MAX_TARGETS = 8, MAX_TOUCHED = 16, ROOM = MAX_JOINED + MAX_TARGETS };

typedef struct {
    PyObject_HEAD
    long long value;
} Epoch;

typedef struct {
    PyObject_HEAD
    PyObject *unsent;
    int fd;
    char ready;
    int count;
    size_t used;
    char *joined; /* a record with room for ROOM messages */
} Link;

typedef struct {
    Link *link;
    uint32_t number;
} Target;

typedef struct {
    PyObject_HEAD
    Epoch *epoch;
    long long sequence, by_lane, matches, quiet_matches, quiet_epoch;
    char direct, busy;
    char gid[GID];
    Py_ssize_t count;
    Target targets[MAX_TARGETS];
} Sender;

static PyTypeObject *epoch_type, *link_type, *sender_type;

/* the links with messages that this thread sends before it waits */
static _Thread_local bool joins;
static _Thread_local Link *touched[MAX_TOUCHED];
static _Thread_local int touched_count;

static void put32(char *at, uint32_t value)
{
    for (int byte = 0; byte < 4; byte++) {
        at[byte] = (char)(value >> (8 * byte));
    }
}

static void put64(char *at, uint64_t value)
{
    put32(at, (uint32_t)value);
    put32(at + 4, (uint32_t)(value >> 32));
}

static PyObject *epoch_renew(PyObject *self, PyObject *Py_UNUSED(unused))
{
    ((Epoch *)self)->value++;
    Py_RETURN_NONE;
}

/* -- links -- */

/* Returns the place for a payload in the joined record, which has room for a message to each target. */
static char *begin(Link *link, uint32_t number, const char *attachment, size_t size)
{
    char *head = link->joined + link->used;
    head[0] = DATA;
    put32(head + 1, number);
    put32(head + 5, (uint32_t)size);
    memcpy(head + 9, attachment, ATTACHMENT);
    link->used += SAMPLE + size;
    link->count++;
    return head + SAMPLE;
}

/* Sends the joined record and returns true; if that fails, the record stays, so that no message overtakes it. */
static bool flush_link(Link *link)
{
    if (link->count > 0 && send(link->fd, link->joined, link->used, MSG_DONTWAIT | MSG_NOSIGNAL) < 0) {
        link->ready = 0;
        return false;
    }
    link->count = 0;
    link->used = 0;
    return true;
}

/* Sends the joined record; returns it if that fails, else None. The caller holds the owner's lock. */
static PyObject *flush_or_take(Link *link)
{
    PyObject *record = flush_link(link) ? Py_NewRef(Py_None)
                                        : PyBytes_FromStringAndSize(link->joined, (Py_ssize_t)link->used);
    link->count = 0;
    link->used = 0;
    return record;
}

/* Sends the joined record, or has the owner flush the link once it has its lock. Until then the record remains, so that
   another thread, which has the lock now, sends nothing before it. */
static void flush_or_queue(Link *link)
{
    PyObject *unsent = flush_link(link) ? NULL : Py_XNewRef(link->unsent);
    PyObject *done = unsent == NULL ? NULL : PyObject_CallNoArgs(unsent);
    if (PyErr_Occurred()) {
        PyErr_WriteUnraisable((PyObject *)link);
    }
    Py_XDECREF(done);
    Py_XDECREF(unsent);
}

static bool is_due(Link *link)
{
    if (!joins || link->count >= MAX_JOINED) {
        return true;
    }
    for (int at = 0; at < touched_count; at++) {
        if (touched[at] == link) {
            return false;
        }
    }
    if (touched_count == MAX_TOUCHED) {
        return true;
    }
    touched[touched_count++] = (Link *)Py_NewRef((PyObject *)link);
    return false;
}

static PyObject *link_join(PyObject *self, PyObject *args)
{
    Link *link = (Link *)self;
    unsigned int number;
    const char *attachment, *payload;
    Py_ssize_t length, size;
    if (!PyArg_ParseTuple(args, "Iy#y#", &number, &attachment, &length, &payload, &size)) {
        return NULL;
    }
    if (length != ATTACHMENT || size > MAX_JOINED_BYTES) {
        PyErr_SetString(PyExc_ValueError, "a message on the lane is too large, or its attachment has another size");
        return NULL;
    }
    if (link->joined == NULL || link->count >= MAX_JOINED) {
        PyErr_SetString(PyExc_ValueError, "the joined messages have to be flushed first");
        return NULL;
    }
    memcpy(begin(link, number, attachment, (size_t)size), payload, (size_t)size);
    return is_due(link) ? flush_or_take(link) : Py_NewRef(Py_None);
}

static PyObject *link_flush(PyObject *self, PyObject *Py_UNUSED(unused))
{
    return flush_or_take((Link *)self);
}

/* False also while a record that could not be sent is full. */
static PyObject *link_ready(PyObject *self, void *Py_UNUSED(closure))
{
    Link *link = (Link *)self;
    return PyBool_FromLong(link->ready && link->count < MAX_JOINED);
}

static int set_link_ready(PyObject *self, PyObject *value, void *Py_UNUSED(closure))
{
    int ready = value == NULL ? 0 : PyObject_IsTrue(value);
    ((Link *)self)->ready = ready > 0;
    return ready < 0 ? -1 : 0;
}

static PyObject *link_close(PyObject *self, PyObject *Py_UNUSED(unused))
{
    Link *link = (Link *)self;
    link->ready = 0;
    link->count = 0;
    link->used = 0;
    Py_CLEAR(link->unsent);
    Py_RETURN_NONE;
}

static int link_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Link *link = (Link *)self;
    PyObject *unsent;
    if (!PyArg_ParseTuple(args, "iO", &link->fd, &unsent)) {
        return -1;
    }
    link->joined = link->joined != NULL ? link->joined : PyMem_Malloc(ROOM * (SAMPLE + MAX_JOINED_BYTES));
    if (link->joined == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    Py_XDECREF(link->unsent);
    link->unsent = Py_NewRef(unsent);
    link->ready = 1;
    return 0;
}

static int link_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((Link *)self)->unsent);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int link_clear(PyObject *self)
{
    Py_CLEAR(((Link *)self)->unsent);
    return 0;
}

static void link_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    link_clear(self);
    PyMem_Free(((Link *)self)->joined);
    release(self);
}

/* -- senders -- */

static PyObject *sender_next(PyObject *self, PyObject *Py_UNUSED(unused))
{
    return PyLong_FromLongLong(++((Sender *)self)->sequence);
}

static void forget_targets(Sender *sender)
{
    while (sender->count > 0) {
        Py_DECREF((PyObject *)sender->targets[--sender->count].link);
    }
}

static PyObject *sender_send_to(PyObject *self, PyObject *pairs)
{
    Sender *sender = (Sender *)self;
    Py_ssize_t count = PyTuple_Size(pairs);
    if (count > MAX_TARGETS) {
        PyErr_SetString(PyExc_ValueError, "too many links");
    }
    forget_targets(sender);
    for (Py_ssize_t at = 0; at < count && !PyErr_Occurred(); at++) {
        PyObject *link;
        unsigned int number;
        if (PyArg_ParseTuple(PyTuple_GetItem(pairs, at), "O!I", link_type, &link, &number)) {
            sender->targets[sender->count++] = (Target){(Link *)Py_NewRef(link), number};
        }
    }
    return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
}

static PyObject *sender_rest(PyObject *self, PyObject *args)
{
    Sender *sender = (Sender *)self;
    if (!PyArg_ParseTuple(args, "LL", &sender->quiet_epoch, &sender->quiet_matches)) {
        return NULL;
    }
    Py_RETURN_NONE;
}

static bool is_quiet(const Sender *sender)
{
    return sender->epoch != NULL && sender->quiet_epoch == sender->epoch->value && sender->quiet_matches == sender->matches;
}

static PyObject *sender_is_quiet(PyObject *self, PyObject *Py_UNUSED(unused))
{
    return PyBool_FromLong(is_quiet((Sender *)self));
}

static PyObject *sender_match(PyObject *self, PyObject *Py_UNUSED(unused))
{
    ((Sender *)self)->matches++;
    Py_RETURN_NONE;
}

static int sender_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Sender *sender = (Sender *)self;
    const char *gid;
    Py_ssize_t length;
    PyObject *epoch;
    if (!PyArg_ParseTuple(args, "y#O!", &gid, &length, epoch_type, &epoch)) {
        return -1;
    }
    if (length != GID || sender->epoch != NULL) {
        PyErr_SetString(PyExc_ValueError, "a publisher has one GID of 16 bytes");
        return -1;
    }
    memcpy(sender->gid, gid, GID);
    sender->epoch = (Epoch *)Py_NewRef(epoch);
    sender->quiet_matches = -1;
    return 0;
}

static void sender_dealloc(PyObject *self)
{
    forget_targets((Sender *)self);
    Py_XDECREF((PyObject *)((Sender *)self)->epoch);
    release(self);
}

static bool is_ready(PyObject *self)
{
    Sender *sender = (Sender *)self;
    bool ready = sender->direct && !sender->busy && is_quiet(sender);
    for (Py_ssize_t at = 0; at < sender->count; at++) {
        const Link *link = sender->targets[at].link;
        ready = ready && link->ready && link->count < MAX_JOINED;
    }
    return ready;
}

static void send_message(PyObject *self, int64_t time_ns, size_t size, void (*write)(void *, char *), void *context)
{
    Sender *sender = (Sender *)self;
    char attachment[ATTACHMENT];
    put64(attachment, (uint64_t)++sender->sequence);
    put64(attachment + 8, (uint64_t)time_ns);
    attachment[16] = GID;
    memcpy(attachment + 17, sender->gid, GID);
    sender->by_lane += sender->count > 0;
    Link *due[MAX_TARGETS];
    int dues = 0;
    for (Py_ssize_t at = 0; at < sender->count; at++) {
        Link *link = sender->targets[at].link;
        write(context, begin(link, sender->targets[at].number, attachment, size));
        if (is_due(link)) {
            due[dues++] = (Link *)Py_NewRef((PyObject *)link);
        }
    }
    for (int at = 0; at < dues; at++) { /* last, because it may call Python */
        flush_or_queue(due[at]);
        Py_DECREF((PyObject *)due[at]);
    }
}

/* -- the module -- */

static PyMemberDef epoch_members[] = {{"value", T_LONGLONG, offsetof(Epoch, value), READONLY, NULL}, {NULL}};
static PyMethodDef epoch_methods[] = {
    {"renew", epoch_renew, METH_NOARGS, "Begin a new epoch."}, {NULL, NULL, 0, NULL},
};
static PyType_Slot epoch_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_dealloc, release}, {Py_tp_members, epoch_members},
    {Py_tp_methods, epoch_methods}, {0, NULL},
};
static PyType_Spec epoch_spec = {"bridge.hub.lane.links.Epoch", sizeof(Epoch), 0, Py_TPFLAGS_DEFAULT, epoch_slots};

static PyGetSetDef link_getters[] = {{"ready", link_ready, set_link_ready, NULL, NULL}, {NULL}};
static PyMethodDef link_methods[] = {
    {"join", link_join, METH_VARARGS, "Join a message, and send if that is due; return the record if it cannot be sent."},
    {"flush", link_flush, METH_NOARGS, "Send the joined messages; return the record if it cannot be sent."},
    {"close", link_close, METH_NOARGS, "Drop the joined messages."},
    {NULL, NULL, 0, NULL},
};
static PyType_Slot link_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, link_init}, {Py_tp_dealloc, link_dealloc},
    {Py_tp_traverse, link_traverse}, {Py_tp_clear, link_clear}, {Py_tp_methods, link_methods},
    {Py_tp_getset, link_getters}, {0, NULL},
};
static PyType_Spec link_spec = {
    "bridge.hub.lane.links.Link", sizeof(Link), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, link_slots,
};

static PyMemberDef sender_members[] = {
    {"sequence", T_LONGLONG, offsetof(Sender, sequence), 0, NULL},
    {"by_lane", T_LONGLONG, offsetof(Sender, by_lane), 0, NULL},
    {"matches", T_LONGLONG, offsetof(Sender, matches), READONLY, NULL},
    {"direct", T_BOOL, offsetof(Sender, direct), 0, NULL},
    {"busy", T_BOOL, offsetof(Sender, busy), 0, NULL},
    {NULL},
};
static PyMethodDef sender_methods[] = {
    {"next", sender_next, METH_NOARGS, "Return the next number."},
    {"send_to", sender_send_to, METH_O, "Set the links, each with the number of the key."},
    {"match", sender_match, METH_NOARGS, "Count a match, after which zenoh may have a subscriber."},
    {"rest", sender_rest, METH_VARARGS, "Store the epoch and the number of matches in which zenoh had no subscriber."},
    {"is_quiet", sender_is_quiet, METH_NOARGS, "Return whether zenoh has no subscriber."},
    {NULL, NULL, 0, NULL},
};
static PyType_Slot sender_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, sender_init}, {Py_tp_dealloc, sender_dealloc},
    {Py_tp_methods, sender_methods}, {Py_tp_members, sender_members}, {0, NULL},
};
static PyType_Spec sender_spec = {"bridge.hub.lane.links.Sender", sizeof(Sender), 0, Py_TPFLAGS_DEFAULT, sender_slots};

static PyObject *flush(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(unused))
{
    while (touched_count > 0) {
        Link *link = touched[--touched_count];
        flush_or_queue(link);
        Py_DECREF((PyObject *)link);
    }
    Py_RETURN_NONE;
}

static PyObject *join(PyObject *Py_UNUSED(module), PyObject *enabled)
{
    joins = PyObject_IsTrue(enabled) > 0;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"join", join, METH_O, "Set whether this thread joins messages until it calls `flush`."},
    {"flush", flush, METH_NOARGS, "Send this thread's joined messages."},
    {NULL, NULL, 0, NULL},
};

static const LinksApi *api(void)
{
    static LinksApi functions = {NULL, is_ready, send_message};
    functions.sender_type = sender_type;
    return &functions;
}

static int add_types(PyObject *module)
{
    struct {
        const char *name;
        PyType_Spec *spec;
        PyTypeObject **type;
    } types[] = {{"Epoch", &epoch_spec, &epoch_type}, {"Link", &link_spec, &link_type}, {"Sender", &sender_spec, &sender_type}};
    for (size_t at = 0; at < sizeof types / sizeof *types; at++) {
        PyObject *type = PyType_FromSpec(types[at].spec);
        if (type == NULL || PyModule_AddObjectRef(module, types[at].name, type) < 0) {
            return -1;
        }
        *types[at].type = (PyTypeObject *)type;
    }
    PyObject *capsule = PyCapsule_New((void *)api(), LINKS_API, NULL);
    int failed = capsule == NULL ? -1 : PyModule_AddObjectRef(module, "api", capsule);
    Py_XDECREF(capsule);
    return failed;
}

#else

static PyMethodDef methods[] = {{NULL, NULL, 0, NULL}};

static int add_types(PyObject *Py_UNUSED(module))
{
    return 0;
}

#endif

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "links", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_links(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made != NULL && add_types(made) < 0) {
        Py_CLEAR(made);
    }
    return made;
}

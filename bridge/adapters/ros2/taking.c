/* Takes the messages of all subscriptions on one thread, several of them each time it gets the interpreter's lock, and
 * publishes messages.
 *
 * rcl reports new messages on the middleware's thread, by a callback that adds the endpoint to a queue and uses no
 * Python. ROS is not linked: the addresses of its functions are passed in, so that this file compiles without ROS.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { BATCH = 16, KEPT = 64 * 1024, TAKE_FAILED = 401, GID_BYTES = 16 };

/* rcl.Wire */
typedef struct {
    char *start;
    size_t length;
    size_t capacity;
    char *exact;
    size_t exact_length;
} Wire;

/* rcutils_allocator_t; by default its functions are libc's */
typedef struct {
    void *functions[5];
} Allocator;

/* rcutils_uint8_array_t */
typedef struct {
    char *buffer;
    size_t length;
    size_t capacity;
    Allocator allocator;
} Bytes;

/* rmw_message_info_t */
typedef struct {
    int64_t source_ns;
    int64_t received_ns;
    uint64_t sequence;
    uint64_t reception_sequence;
    const char *implementation;
    char gid[GID_BYTES];
    bool from_this_process;
} Info;

typedef int32_t (*Take)(const void *subscription, void *message, void *info, void *allocation);
typedef struct Queue Queue;

typedef struct Node {
    struct Node *next; /* in the queue, while it is queued */
    bool queued;
    size_t count; /* new messages */
    Queue *queue;
    PyObject *reader;
    void *subscription; /* rcl_subscription_t *; NULL if the reader takes by itself */
    size_t last;        /* bytes of the last message, if it was large */
    bool steady;        /* whether the message before the last had as many bytes */
    PyObject *deliver;   /* deliver(payload, source, time) for small messages; NULL: the reader accepts them */
    PyObject *sources;   /* dict: the publishers whose messages are delivered, by GID */
    PyObject *sequences; /* dict: the last number of each publisher */
} Node;

typedef struct {
    Node *node;
    Bytes bytes;
    Info info;
    size_t count; /* messages that the reader has to take itself; then there is no message here */
    PyObject *payload;
} Slot;

struct Queue {
    PyObject_HEAD
    Take take_serialized; /* rcl_take_serialized_message */
    Take take;            /* rcl_take */
    void (*reset_error)(void); /* rcutils_reset_error */
    size_t large;
    PyObject *flush;           /* called before waiting; NULL: nothing */
    PyThread_type_lock lock;   /* guards the following and the nodes; never held while calling ROS or Python */
    PyThread_type_lock signal; /* a semaphore: released once for each time that `waits` becomes false */
    bool waits;
    bool woken;
    bool ended; /* whether `wake` was called before the last messages were taken; only the taking thread uses it */
    Node *first, *last;
    Slot slots[BATCH];
};

static void append(Queue *queue, Node *node)
{
    node->next = NULL;
    node->queued = true;
    if (queue->last == NULL) {
        queue->first = node;
    } else {
        queue->last->next = node;
    }
    queue->last = node;
}

static void lock(Queue *queue)
{
    PyThread_acquire_lock(queue->lock, WAIT_LOCK);
}

static void unlock(Queue *queue)
{
    PyThread_release_lock(queue->lock);
}

/* Unlocks first: the woken thread would only wait for the lock. */
static void unlock_and_signal(Queue *queue)
{
    bool waits = queue->waits;
    queue->waits = false;
    unlock(queue);
    if (waits) {
        PyThread_release_lock(queue->signal);
    }
}

/* rcl_event_callback_t */
static void on_new_messages(const void *data, size_t count)
{
    Node *node = (Node *)data;
    Queue *queue = node->queue;
    lock(queue);
    node->count += count;
    if (node->count == 0 || node->queued) {
        unlock(queue);
        return;
    }
    append(queue, node);
    unlock_and_signal(queue);
}

static Node *pop(Queue *queue, size_t *count)
{
    Node *node = queue->first;
    queue->first = node->next;
    if (queue->first == NULL) {
        queue->last = NULL;
    }
    node->queued = false;
    *count = node->count;
    node->count = 0;
    return node;
}

/* Queues a node behind the others again, if not all of its messages were taken. */
static void put_back(Queue *queue, Node *node, size_t count)
{
    node->count += count;
    if (node->count > 0 && !node->queued) {
        append(queue, node);
    }
}

/* Takes a large message with one copy: as a structure, whose deserializer (service_callbacks.c) copies the bytes. Before
 * that, Fast DDS drops a message that is not CDR, and returns none; it is counted as lost, by the publisher's numbers.
 * Small messages are taken serialized. */
static int32_t take_large(Queue *queue, Node *node, Slot *slot, char **exact, size_t exact_length)
{
    Wire wire = {slot->bytes.buffer, 0, slot->bytes.capacity, *exact, exact_length};
    int32_t code = queue->take(node->subscription, &wire, &slot->info, NULL);
    slot->bytes.buffer = wire.start;
    slot->bytes.length = wire.length;
    slot->bytes.capacity = wire.capacity;
    *exact = wire.exact;
    return code;
}

/* Takes one message; returns whether there was one. A message of `exact_length` bytes may be put where `exact` points;
 * `exact` is NULL then. If Fast DDS has dropped a message, the next one is taken. An unexpected error is left to the
 * reader's own way of taking. */
static bool take_one(Queue *queue, Node *node, Slot *slot, char **exact, size_t exact_length)
{
    slot->node = node;
    slot->count = 0;
    int32_t code = TAKE_FAILED;
    if (node->last > 0) {
        code = take_large(queue, node, slot, exact, exact_length);
        if (code == TAKE_FAILED) {
            queue->reset_error();
        }
    }
    if (code == TAKE_FAILED) {
        code = queue->take_serialized(node->subscription, &slot->bytes, &slot->info, NULL);
    }
    if (code == 0) {
        size_t length = slot->bytes.length;
        node->steady = length >= queue->large && length == node->last;
        node->last = length >= queue->large ? length : 0;
        return true;
    }
    queue->reset_error();
    if (code == TAKE_FAILED) {
        return false;
    }
    slot->count = 1;
    return true;
}

/* Waits for messages, and takes some; returns the number of filled slots. A large message is the last one, so that none
 * waits for others. A node whose messages are large and equally long is only returned, in `large`. Runs without the
 * interpreter's lock. */
static size_t wait_and_take(Queue *queue, Node **large)
{
    size_t filled = 0;
    *large = NULL;
    lock(queue);
    while (queue->first == NULL && !queue->woken) {
        queue->waits = true;
        unlock(queue);
        PyThread_acquire_lock(queue->signal, WAIT_LOCK);
        lock(queue);
    }
    queue->ended = queue->woken;
    queue->woken = false;
    while (queue->first != NULL && filled < BATCH && (filled == 0 || queue->first->last == 0)) {
        size_t count;
        Node *node = pop(queue, &count);
        if (node->steady) {
            put_back(queue, node, count - 1);
            *large = node;
            break;
        }
        if (node->subscription == NULL) {
            size_t now = count < BATCH ? count : BATCH;
            put_back(queue, node, count - now);
            queue->slots[filled].node = node;
            queue->slots[filled++].count = now;
            continue;
        }
        unlock(queue);
        bool took_large = false;
        while (count > 0 && filled < BATCH && !took_large) {
            char *none = NULL;
            if (!take_one(queue, node, &queue->slots[filled], &none, 0)) {
                count = 0;
                break;
            }
            filled++;
            count--;
            took_large = node->last > 0;
        }
        lock(queue);
        put_back(queue, node, count);
        if (took_large) {
            break;
        }
    }
    unlock(queue);
    return filled;
}

/* Takes a message into the bytes object that becomes its payload. */
static bool take_exact(Queue *queue, Node *node, Slot *slot)
{
    size_t length = node->last;
    PyObject *payload = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)length);
    char *exact = payload == NULL ? NULL : PyBytes_AsString(payload);
    if (payload == NULL) {
        PyErr_Clear();
    }
    bool taken;
    Py_BEGIN_ALLOW_THREADS
    taken = take_one(queue, node, slot, &exact, length);
    Py_END_ALLOW_THREADS
    if (taken && slot->count == 0 && exact == NULL) {
        slot->payload = payload;
    } else {
        Py_XDECREF(payload);
    }
    return taken;
}

static PyObject *entry(Slot *slot)
{
    PyObject *payload = slot->payload;
    slot->payload = NULL;
    if (slot->count > 0) {
        return Py_BuildValue("(OOy#nn)", slot->node->reader, Py_None, "", (Py_ssize_t)0, (Py_ssize_t)slot->count,
                             (Py_ssize_t)0);
    }
    if (payload == NULL) {
        payload = PyBytes_FromStringAndSize(slot->bytes.buffer, (Py_ssize_t)slot->bytes.length);
    }
    if (slot->bytes.capacity > KEPT) {
        free(slot->bytes.buffer);
        slot->bytes.buffer = NULL;
        slot->bytes.capacity = 0;
    }
    if (payload == NULL) {
        return NULL;
    }
    return Py_BuildValue("(ONy#LL)", slot->node->reader, payload, slot->info.gid, (Py_ssize_t)GID_BYTES,
                         (long long)slot->info.source_ns, (long long)slot->info.sequence);
}

/* Notes a publisher's number; the reader counts missing messages. */
static void note_sequence(Node *node, PyObject *source, uint64_t sequence)
{
    PyObject *last = PyDict_GetItemWithError(node->sequences, source);
    PyObject *number = PyLong_FromUnsignedLongLong(sequence);
    bool next = last != NULL && sequence > 0 && PyLong_AsUnsignedLongLong(last) == sequence - 1;
    PyErr_Clear();
    PyObject *done = number == NULL ? NULL : Py_NewRef(Py_None);
    if (number != NULL && (!next || PyDict_SetItem(node->sequences, source, number) < 0)) {
        Py_DECREF(done);
        PyErr_Clear(); /* of the dictionary, without memory */
        done = PyObject_CallMethod(node->reader, "count", "OO", source, number);
    }
    if (done == NULL) {
        PyErr_WriteUnraisable(node->reader);
    }
    Py_XDECREF(done);
    Py_XDECREF(number);
}

/* Has the reader log the exception of a message. */
static void report_error(Node *node, PyObject *source)
{
    PyObject *type, *value, *traceback;
    PyErr_Fetch(&type, &value, &traceback);
    PyErr_NormalizeException(&type, &value, &traceback);
    if (value != NULL && traceback != NULL) {
        PyException_SetTraceback(value, traceback);
    }
    PyObject *done = value == NULL ? NULL : PyObject_CallMethod(node->reader, "failed", "OO", source, value);
    if (done == NULL) {
        PyErr_WriteUnraisable(node->reader);
    }
    Py_XDECREF(done);
    Py_XDECREF(type);
    Py_XDECREF(value);
    Py_XDECREF(traceback);
}

/* Delivers a small message of a known publisher; returns false if the reader has to accept it. */
static bool deliver(Queue *queue, Slot *slot)
{
    Node *node = slot->node;
    if (slot->count > 0 || slot->payload != NULL || node->deliver == NULL || slot->bytes.length >= queue->large) {
        return false;
    }
    PyObject *gid = PyBytes_FromStringAndSize(slot->info.gid, GID_BYTES);
    PyObject *source = gid == NULL ? NULL : Py_XNewRef(PyDict_GetItemWithError(node->sources, gid));
    Py_XDECREF(gid);
    if (source == NULL) {
        PyErr_Clear();
        return false;
    }
    PyObject *payload = PyBytes_FromStringAndSize(slot->bytes.buffer, (Py_ssize_t)slot->bytes.length);
    PyObject *time = payload == NULL ? NULL : PyLong_FromLongLong(slot->info.source_ns);
    PyObject *done = time == NULL ? NULL : PyObject_CallFunctionObjArgs(node->deliver, payload, source, time, NULL);
    if (done == NULL) {
        report_error(node, source);
    }
    note_sequence(node, source, slot->info.sequence);
    Py_XDECREF(done);
    Py_XDECREF(time);
    Py_XDECREF(payload);
    Py_DECREF(source);
    return true;
}

static int flush(Queue *queue)
{
    PyObject *done = queue->flush == NULL ? Py_NewRef(Py_None) : PyObject_CallNoArgs(queue->flush);
    Py_XDECREF(done);
    return done == NULL ? -1 : 0;
}

/* Waits once, and appends to the batch what the readers have to accept. Returns 1 if `queue_wait` has to return, 0 if it
 * may wait again, and -1 with an exception. */
static int wait_once(Queue *queue, PyObject *batch)
{
    size_t filled;
    Node *large;
    Py_BEGIN_ALLOW_THREADS
    filled = wait_and_take(queue, &large);
    Py_END_ALLOW_THREADS
    if (large != NULL) {
        filled = take_exact(queue, large, &queue->slots[0]) ? 1 : 0;
    }
    bool delivers = true; /* until a reader has to accept a message, which none may overtake */
    for (size_t at = 0; at < filled; at++) {
        delivers = delivers && deliver(queue, &queue->slots[at]);
        if (delivers) {
            continue;
        }
        PyObject *taken = entry(&queue->slots[at]);
        if (taken == NULL || PyList_Append(batch, taken) < 0) {
            PyErr_WriteUnraisable((PyObject *)queue); /* no memory: this message is lost, the others are not */
        }
        Py_XDECREF(taken);
    }
    return filled == 0 || queue->ended ? 1 : 0;
}

static PyObject *queue_wait(PyObject *self, PyObject *Py_UNUSED(unused))
{
    PyObject *batch = PyList_New(0);
    int ended = batch == NULL ? -1 : 0;
    while (ended == 0 && PyList_Size(batch) == 0) {
        ended = flush((Queue *)self) < 0 ? -1 : wait_once((Queue *)self, batch);
    }
    if (ended < 0) {
        Py_CLEAR(batch);
    }
    return batch;
}

static PyObject *queue_deliver(PyObject *Py_UNUSED(self), PyObject *args)
{
    PyObject *address, *call, *sources, *sequences;
    if (!PyArg_ParseTuple(args, "OOO!O!", &address, &call, &PyDict_Type, &sources, &PyDict_Type, &sequences)) {
        return NULL;
    }
    Node *node = PyLong_AsVoidPtr(address);
    if (node == NULL) {
        return NULL;
    }
    node->deliver = Py_NewRef(call);
    node->sources = Py_NewRef(sources);
    node->sequences = Py_NewRef(sequences);
    Py_RETURN_NONE;
}

static PyObject *queue_wake(PyObject *self, PyObject *Py_UNUSED(unused))
{
    Queue *queue = (Queue *)self;
    Py_BEGIN_ALLOW_THREADS
    lock(queue);
    queue->woken = true;
    unlock_and_signal(queue);
    Py_END_ALLOW_THREADS
    Py_RETURN_NONE;
}

static PyObject *queue_add(PyObject *self, PyObject *args)
{
    PyObject *reader, *subscription;
    if (!PyArg_ParseTuple(args, "OO", &reader, &subscription)) {
        return NULL;
    }
    void *pointer = PyLong_AsVoidPtr(subscription);
    if (pointer == NULL && PyErr_Occurred()) {
        return NULL;
    }
    Node *node = calloc(1, sizeof *node);
    if (node == NULL) {
        return PyErr_NoMemory();
    }
    node->queue = (Queue *)self;
    node->reader = Py_NewRef(reader);
    node->subscription = pointer;
    return PyLong_FromVoidPtr(node);
}

static PyObject *queue_remove(PyObject *self, PyObject *address)
{
    Queue *queue = (Queue *)self;
    Node *gone = PyLong_AsVoidPtr(address);
    if (gone == NULL) {
        return NULL;
    }
    Py_BEGIN_ALLOW_THREADS
    lock(queue);
    Node *before = NULL;
    for (Node *node = gone->queued ? queue->first : NULL; node != NULL; before = node, node = node->next) {
        if (node == gone) {
            *(before == NULL ? &queue->first : &before->next) = node->next;
            queue->last = queue->last == node ? before : queue->last;
            break;
        }
    }
    unlock(queue);
    Py_END_ALLOW_THREADS
    Py_DECREF(gone->reader);
    Py_XDECREF(gone->deliver);
    Py_XDECREF(gone->sources);
    Py_XDECREF(gone->sequences);
    free(gone);
    Py_RETURN_NONE;
}

static int queue_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Queue *queue = (Queue *)self;
    unsigned long long take_serialized, take, reset_error, default_allocator;
    Py_ssize_t large;
    PyObject *before_wait = NULL;
    if (!PyArg_ParseTuple(args, "KKKKn|O", &take_serialized, &take, &reset_error, &default_allocator, &large,
                          &before_wait)) {
        return -1;
    }
    queue->flush = Py_XNewRef(before_wait);
    queue->take_serialized = (Take)(uintptr_t)take_serialized;
    queue->take = (Take)(uintptr_t)take;
    queue->reset_error = (void (*)(void))(uintptr_t)reset_error;
    Allocator (*get_allocator)(void) = (Allocator (*)(void))(uintptr_t)default_allocator;
    for (int at = 0; at < BATCH; at++) {
        queue->slots[at].bytes.allocator = get_allocator(); /* rcutils_get_default_allocator */
    }
    queue->large = (size_t)large;
    queue->lock = PyThread_allocate_lock();
    queue->signal = PyThread_allocate_lock();
    if (queue->lock == NULL || queue->signal == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    PyThread_acquire_lock(queue->signal, WAIT_LOCK);
    return 0;
}

static void queue_dealloc(PyObject *self)
{
    Queue *queue = (Queue *)self;
    PyTypeObject *type = Py_TYPE(self);
    freefunc release = (freefunc)PyType_GetSlot(type, Py_tp_free);
    PyThread_type_lock locks[] = {queue->lock, queue->signal};
    for (int at = 0; at < 2; at++) {
        if (locks[at] != NULL) {
            PyThread_free_lock(locks[at]);
        }
    }
    for (size_t at = 0; at < BATCH; at++) {
        free(queue->slots[at].bytes.buffer);
    }
    Py_XDECREF(queue->flush);
    release(self);
    Py_DECREF(type);
}

static PyMethodDef queue_methods[] = {
    {"wait", queue_wait, METH_NOARGS, "Wait for messages or `wake`; return the messages."},
    {"wake", queue_wake, METH_NOARGS, "End `wait`."},
    {"add", queue_add, METH_VARARGS, "Add a reader and its rcl_subscription_t *; return the callback's data."},
    {"deliver", queue_deliver, METH_VARARGS,
     "Deliver a reader's small messages of some publishers (a dict from GIDs to ids) by a call, without the reader."},
    {"remove", queue_remove, METH_O, "Remove the reader with this data, whose callback is no longer set."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot queue_slots[] = {
    {Py_tp_init, queue_init}, {Py_tp_new, PyType_GenericNew}, {Py_tp_dealloc, queue_dealloc},
    {Py_tp_methods, queue_methods}, {0, NULL},
};

static PyType_Spec queue_spec = {
    "bridge.adapters.ros2.taking.Queue", sizeof(Queue), 0, Py_TPFLAGS_DEFAULT, queue_slots,
};

/* Keeps the interpreter's lock for a small message: releasing it would cost more than the call. */
static PyObject *publish(PyObject *Py_UNUSED(module), PyObject *args)
{
    unsigned long long function, publisher;
    Py_buffer payload;
    Py_ssize_t large;
    if (!PyArg_ParseTuple(args, "KKy*n", &function, &publisher, &payload, &large)) {
        return NULL;
    }
    typedef int32_t (*Publish)(const void *publisher, const Bytes *message, void *allocation);
    Publish call = (Publish)(uintptr_t)function; /* rcl_publish_serialized_message */
    Bytes message = {payload.buf, (size_t)payload.len, (size_t)payload.len, {{NULL}}};
    int32_t code;
    if (payload.len < large) {
        code = call((const void *)(uintptr_t)publisher, &message, NULL);
    } else {
        Py_BEGIN_ALLOW_THREADS
        code = call((const void *)(uintptr_t)publisher, &message, NULL);
        Py_END_ALLOW_THREADS
    }
    PyBuffer_Release(&payload);
    return PyLong_FromLong(code);
}

static PyMethodDef methods[] = {
    {"publish", publish, METH_VARARGS,
     "Call rcl_publish_serialized_message, whose address is passed, with an rcl_publisher_t * and CDR bytes; return its "
     "code. From a length on, without the interpreter's lock."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "taking", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_taking(void)
{
    PyObject *made = PyModule_Create(&module);
    PyObject *type = PyType_FromSpec(&queue_spec);
    PyObject *callback = PyLong_FromVoidPtr((void *)on_new_messages);
    if (made == NULL || type == NULL || callback == NULL || PyModule_AddObjectRef(made, "Queue", type) < 0 ||
        PyModule_AddObjectRef(made, "ON_NEW_MESSAGES", callback) < 0) {
        Py_XDECREF(made);
        made = NULL;
    }
    Py_XDECREF(type);
    Py_XDECREF(callback);
    return made;
}

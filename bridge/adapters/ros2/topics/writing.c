/* Publishes small messages by rcl without the interpreter. ROS is not linked: the address of its function is passed in.
 *
 * Everything runs while the interpreter's lock is held: releasing it would cost more than the call.
 */

#define PY_SSIZE_T_CLEAN
#include "../../../native.h"
#include "../../../routing/output.h"
#include <stdint.h>
#include <structmember.h>

/* rcutils_uint8_array_t */
typedef struct {
    char *buffer;
    size_t length;
    size_t capacity;
    void *allocator[5];
} Bytes;

typedef int32_t (*Publish)(const void *publisher, const Bytes *message, void *allocation);

typedef struct {
    PyObject_HEAD
    PyObject *locked;      /* tuple of the call that returns whether the writer's lock is held */
    Publish publish;       /* rcl_publish_serialized_message */
    void (*reset_error)(void); /* rcutils_reset_error */
    const void *publisher; /* rcl_publisher_t * */
    Py_ssize_t large;      /* from this size on, Python publishes, without the interpreter's lock */
    long long written;
    char open;
} Writer;

static bool is_ready(PyObject *self)
{
    bool ready = ((Writer *)self)->open && !is_any_locked(((Writer *)self)->locked);
    PyErr_Clear(); /* of a call, which then counts as locked */
    return ready;
}

static bool send_message(PyObject *self, char *message, size_t size)
{
    Writer *writer = (Writer *)self;
    if (size >= (size_t)writer->large) {
        return false;
    }
    Bytes bytes = {message, size, size, {NULL}};
    if (writer->publish(writer->publisher, &bytes, NULL) != 0) {
        writer->reset_error();
        return false; /* Python tries again, and raises the error */
    }
    writer->written++;
    return true;
}

static PyObject *writer_output(PyObject *Py_UNUSED(self), void *Py_UNUSED(closure))
{
    static const Output output = {is_ready, send_message};
    return PyCapsule_New((void *)&output, OUTPUT, NULL);
}

static int writer_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Writer *writer = (Writer *)self;
    unsigned long long publish, reset_error, publisher;
    PyObject *locked;
    if (!PyArg_ParseTuple(args, "KKKnO!", &publish, &reset_error, &publisher, &writer->large, &PyTuple_Type, &locked)) {
        return -1;
    }
    Py_XDECREF(writer->locked);
    writer->publish = (Publish)(uintptr_t)publish;
    writer->reset_error = (void (*)(void))(uintptr_t)reset_error;
    writer->publisher = (const void *)(uintptr_t)publisher;
    writer->locked = Py_NewRef(locked);
    return 0;
}

static int writer_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(((Writer *)self)->locked);
    Py_VISIT(Py_TYPE(self));
    return 0;
}

static int writer_clear(PyObject *self)
{
    ((Writer *)self)->open = 0;
    Py_CLEAR(((Writer *)self)->locked);
    return 0;
}

static void writer_dealloc(PyObject *self)
{
    PyObject_GC_UnTrack(self);
    writer_clear(self);
    release(self);
}

static PyMemberDef writer_members[] = {
    {"open", T_BOOL, offsetof(Writer, open), 0, NULL},
    {"written", T_LONGLONG, offsetof(Writer, written), READONLY, NULL},
    {NULL},
};
static PyGetSetDef writer_getters[] = {{"output", writer_output, NULL, NULL, NULL}, {NULL}};
static PyType_Slot writer_slots[] = {
    {Py_tp_new, PyType_GenericNew}, {Py_tp_init, writer_init}, {Py_tp_dealloc, writer_dealloc},
    {Py_tp_traverse, writer_traverse}, {Py_tp_clear, writer_clear}, {Py_tp_members, writer_members},
    {Py_tp_getset, writer_getters}, {0, NULL},
};
static PyType_Spec writer_spec = {
    "bridge.adapters.ros2.topics.writing.Writer", sizeof(Writer), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    writer_slots,
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "writing", .m_size = -1};

PyMODINIT_FUNC PyInit_writing(void)
{
    PyObject *made = PyModule_Create(&module);
    PyObject *type = PyType_FromSpec(&writer_spec);
    if (made == NULL || type == NULL || PyModule_AddObjectRef(made, "Writer", type) < 0) {
        Py_CLEAR(made);
    }
    Py_XDECREF(type);
    return made;
}

/* Chooses the subscriptions to which a DDS writer sends: those of some versions of its type, or all others.
 *
 * Fast DDS calls a writer's filter on its own threads before it sends a message to a reader, and sends a GAP if the
 * filter returns false. The filter is a C++ object with one virtual function (rtps/interfaces/IReaderDataFilter.hpp of
 * Fast DDS 2.14 and 3.2), built here from a table with this function, as in the Itanium C++ ABI. A reader's version is
 * in the graph of rmw before Fast DDS matches it with a writer, so no message goes to a reader of the wrong version. The
 * filter runs without Python, with the writer's lock held; the graph's lock, which it takes, is never held by a thread
 * that waits for a writer. ROS is not linked: the addresses of its functions are passed in.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { GID_BYTES = 16, HASH_BYTES = 32, CACHED = 64, FUNCTIONS = 8 };

/* rcutils_allocator_t */
typedef struct {
    void *functions[5];
} Allocator;

/* rmw_time_t, rmw_qos_profile_t */
typedef struct {
    uint64_t sec, nsec;
} Time;

typedef struct {
    int history;
    size_t depth;
    int reliability, durability;
    Time deadline, lifespan;
    int liveliness;
    Time lease;
    bool avoid_ros_namespace_conventions;
} Qos;

/* rmw_topic_endpoint_info_t and its array */
typedef struct {
    const char *node, *space, *type;
    struct {
        uint8_t version;
        uint8_t value[HASH_BYTES];
    } hash;
    int kind;
    uint8_t gid[GID_BYTES];
    Qos qos;
} Info;

typedef struct {
    size_t size;
    Info *infos;
} Infos;

typedef bool (*IsRelevant)(const void *self, const void *change, const uint8_t *gid);

typedef struct {
    const IsRelevant *table;
} CppObject;

typedef struct {
    uint8_t gid[GID_BYTES];
    bool relevant;
} Known;

/* The addresses that `configure` sets */
static const void *writer_table;              /* StatefulWriter's virtual functions */
static CppObject *(*get_filter)(const void *); /* StatefulWriter::reader_data_filter, as a getter and a setter */
static void (*set_filter)(void *, const void *);
static void *(*find_writer)(const void *gid); /* RTPSDomainImpl::find_local_writer */
static int32_t (*get_readers)(const void *node, Allocator *, const char *topic, bool raw, Infos *);
static int32_t (*free_infos)(Infos *, Allocator *); /* rmw_topic_endpoint_info_array_fini */
static void (*reset_error)(void);
static Allocator (*default_allocator)(void);

typedef struct {
    PyObject_HEAD
    CppObject object; /* its address is what Fast DDS gets */
    CppObject *previous; /* Fast DDS's own filter, for subscriptions with a filter by content; NULL if it has none */
    PyThread_type_lock lock; /* guards `known` */
    Known known[CACHED];
    size_t count;
    const void *node; /* rcl_node_t */
    char *topic;
    uint8_t *hashes;
    size_t hash_count;
    bool hashless; /* whether the version of ROS 2 programs that announce no hash is one of them */
    bool only;     /* whether it sends to these versions only, or to all others */
} Filter;

static bool is_listed(const Filter *filter, const Info *info)
{
    if (info->hash.version != 1) {
        return filter->hashless && (info->node == NULL || strcmp(info->node, "_CREATED_BY_BARE_DDS_APP_") != 0);
    }
    for (size_t at = 0; at < filter->hash_count; at++) {
        if (memcmp(filter->hashes + at * HASH_BYTES, info->hash.value, HASH_BYTES) == 0) {
            return true;
        }
    }
    return false;
}

/* Reads a reader's version from the graph; returns whether it is there. */
static bool read_version(const Filter *filter, const uint8_t *gid, bool *relevant)
{
    Allocator allocator = default_allocator();
    Infos all = {0, NULL};
    bool found = false;
    if (get_readers(filter->node, &allocator, filter->topic, false, &all) != 0) {
        reset_error();
        return false;
    }
    for (size_t at = 0; at < all.size && !found; at++) {
        found = memcmp(all.infos[at].gid, gid, GID_BYTES) == 0;
        if (found) {
            *relevant = is_listed(filter, &all.infos[at]) == filter->only;
        }
    }
    if (free_infos(&all, &allocator) != 0) {
        reset_error();
    }
    return found;
}

static bool find_known(Filter *filter, const uint8_t *gid, bool *relevant)
{
    bool found = false;
    PyThread_acquire_lock(filter->lock, WAIT_LOCK);
    for (size_t at = 0; at < filter->count && !found; at++) {
        found = memcmp(filter->known[at].gid, gid, GID_BYTES) == 0;
        if (found) {
            *relevant = filter->known[at].relevant;
        }
    }
    PyThread_release_lock(filter->lock);
    return found;
}

static void add_known(Filter *filter, const uint8_t *gid, bool relevant)
{
    PyThread_acquire_lock(filter->lock, WAIT_LOCK);
    if (filter->count == CACHED) { /* most have left */
        filter->count = 0;
    }
    Known *known = &filter->known[filter->count++];
    memcpy(known->gid, gid, GID_BYTES);
    known->relevant = relevant;
    PyThread_release_lock(filter->lock);
}

static bool is_relevant(const void *self, const void *change, const uint8_t *gid)
{
    Filter *filter = (Filter *)((char *)self - offsetof(Filter, object));
    bool relevant = !filter->only;
    if (!find_known(filter, gid, &relevant) && read_version(filter, gid, &relevant)) {
        add_known(filter, gid, relevant);
    }
    CppObject *previous = filter->previous;
    return relevant && (previous == NULL || previous->table[0](previous, change, gid));
}

static const IsRelevant table[FUNCTIONS] = {is_relevant};

static PyObject *filter_attach(PyObject *self, PyObject *args)
{
    Filter *filter = (Filter *)self;
    const char *gid;
    Py_ssize_t length;
    if (!PyArg_ParseTuple(args, "y#", &gid, &length)) {
        return NULL;
    }
    void *writer = length == GID_BYTES && find_writer != NULL ? find_writer(gid) : NULL;
    if (writer == NULL || *(const void **)writer != writer_table) {
        Py_RETURN_FALSE;
    }
    filter->previous = get_filter(writer);
    set_filter(writer, &filter->object);
    Py_RETURN_TRUE;
}

static int filter_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    Filter *filter = (Filter *)self;
    unsigned long long node;
    const char *topic, *hashes;
    Py_ssize_t length;
    int hashless, only;
    if (!PyArg_ParseTuple(args, "Ksy#pp", &node, &topic, &hashes, &length, &hashless, &only)) {
        return -1;
    }
    filter->object.table = table;
    filter->node = (const void *)(uintptr_t)node;
    filter->hashless = hashless != 0;
    filter->only = only != 0;
    filter->hash_count = (size_t)length / HASH_BYTES;
    filter->topic = malloc(strlen(topic) + 1);
    filter->hashes = malloc((size_t)length + 1);
    filter->lock = PyThread_allocate_lock();
    if (filter->topic == NULL || filter->hashes == NULL || filter->lock == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    strcpy(filter->topic, topic);
    memcpy(filter->hashes, hashes, (size_t)length);
    return 0;
}

static void filter_dealloc(PyObject *self)
{
    Filter *filter = (Filter *)self;
    PyTypeObject *type = Py_TYPE(self);
    freefunc release = (freefunc)PyType_GetSlot(type, Py_tp_free);
    free(filter->topic);
    free(filter->hashes);
    if (filter->lock != NULL) {
        PyThread_free_lock(filter->lock);
    }
    release(self);
    Py_DECREF(type);
}

static PyMethodDef filter_methods[] = {
    {"attach", filter_attach, METH_VARARGS,
     "Filter what the reliable writer with this GID sends, until it is destroyed; return whether there is one."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot filter_slots[] = {
    {Py_tp_init, filter_init}, {Py_tp_new, PyType_GenericNew}, {Py_tp_dealloc, filter_dealloc},
    {Py_tp_methods, filter_methods}, {0, NULL},
};

static PyType_Spec filter_spec = {
    "bridge.adapters.ros2.version_filter.Filter", sizeof(Filter), 0, Py_TPFLAGS_DEFAULT, filter_slots,
};

static PyObject *configure(PyObject *Py_UNUSED(module), PyObject *args)
{
    unsigned long long at[8];
    if (!PyArg_ParseTuple(args, "KKKKKKKK", at, at + 1, at + 2, at + 3, at + 4, at + 5, at + 6, at + 7)) {
        return NULL;
    }
    writer_table = (const char *)(uintptr_t)at[0] + 2 * sizeof(void *); /* after the offset and the type */
    get_filter = (CppObject * (*)(const void *))(uintptr_t)at[1];
    set_filter = (void (*)(void *, const void *))(uintptr_t)at[2];
    find_writer = (void *(*)(const void *))(uintptr_t)at[3];
    get_readers = (int32_t(*)(const void *, Allocator *, const char *, bool, Infos *))(uintptr_t)at[4];
    free_infos = (int32_t(*)(Infos *, Allocator *))(uintptr_t)at[5];
    reset_error = (void (*)(void))(uintptr_t)at[6];
    default_allocator = (Allocator(*)(void))(uintptr_t)at[7];
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"configure", configure, METH_VARARGS,
     "Set the addresses of StatefulWriter's virtual functions, its reader_data_filter as getter and setter, "
     "find_local_writer, rcl_get_subscriptions_info_by_topic, rmw_topic_endpoint_info_array_fini, rcutils_reset_error, "
     "rcutils_get_default_allocator."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, .m_name = "version_filter", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_version_filter(void)
{
    PyObject *made = PyModule_Create(&module);
    PyObject *type = PyType_FromSpec(&filter_spec);
    if (made == NULL || type == NULL || PyModule_AddObjectRef(made, "Filter", type) < 0) {
        Py_XDECREF(made);
        made = NULL;
    }
    Py_XDECREF(type);
    return made;
}

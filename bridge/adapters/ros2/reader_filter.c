/* Chooses the readers to which a DDS writer sends: by their version of its type, or by a list of their GIDs.
 *
 * Fast DDS calls a writer's filter on its own threads before it sends a message to a reader, and sends a GAP if the
 * filter returns false. The filter is a C++ object with one virtual function (rtps/interfaces/IReaderDataFilter.hpp of
 * Fast DDS 2.14 and 3.2), built here from a table with this function, as in the Itanium C++ ABI. A reader's version is
 * in the graph of rmw before Fast DDS matches it with a writer, and a reader that is not listed gets nothing, so no
 * message goes to a wrong reader. The filter runs without Python, with the writer's lock held; it takes the graph's
 * lock, which no thread holds while it waits for a writer. ROS is not linked: the addresses of its functions are passed
 * in.
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

/* The beginning of all filters */
typedef struct {
    PyObject_HEAD
    CppObject object; /* its address is what Fast DDS gets */
    CppObject *previous; /* Fast DDS's own filter, for subscriptions with a filter by content; NULL if it has none */
} Filter;

typedef struct {
    Filter base;
    PyThread_type_lock lock; /* guards `known` */
    Known known[CACHED];
    size_t count;
    const void *node; /* rcl_node_t */
    char *topic;
    uint8_t *hashes;
    size_t hash_count;
    bool hashless; /* whether the version of ROS 2 programs that announce no hash is one of them */
    bool only;     /* whether it sends to these versions only, or to all others */
} VersionFilter;

typedef struct {
    Filter base;
    PyThread_type_lock lock; /* guards the list */
    uint8_t *gids;
    size_t count;
} ListFilter;

static Filter *filter_of(const void *object)
{
    return (Filter *)((char *)object - offsetof(Filter, object));
}

static bool passes_previous(const Filter *filter, const void *change, const uint8_t *gid)
{
    CppObject *previous = filter->previous;
    return previous == NULL || previous->table[0](previous, change, gid);
}

static bool is_listed(const VersionFilter *filter, const Info *info)
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
static bool read_version(const VersionFilter *filter, const uint8_t *gid, bool *relevant)
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

static bool find_known(VersionFilter *filter, const uint8_t *gid, bool *relevant)
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

static void add_known(VersionFilter *filter, const uint8_t *gid, bool relevant)
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

static bool has_version(const void *self, const void *change, const uint8_t *gid)
{
    VersionFilter *filter = (VersionFilter *)filter_of(self);
    bool relevant = !filter->only;
    if (!find_known(filter, gid, &relevant) && read_version(filter, gid, &relevant)) {
        add_known(filter, gid, relevant);
    }
    return relevant && passes_previous(&filter->base, change, gid);
}

static bool has_listed_gid(const void *self, const void *change, const uint8_t *gid)
{
    ListFilter *filter = (ListFilter *)filter_of(self);
    bool listed = false;
    PyThread_acquire_lock(filter->lock, WAIT_LOCK);
    for (size_t at = 0; at < filter->count && !listed; at++) {
        listed = memcmp(filter->gids + at * GID_BYTES, gid, GID_BYTES) == 0;
    }
    PyThread_release_lock(filter->lock);
    return listed && passes_previous(&filter->base, change, gid);
}

static const IsRelevant by_version[FUNCTIONS] = {has_version};
static const IsRelevant by_list[FUNCTIONS] = {has_listed_gid};

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

static int version_init(PyObject *self, PyObject *args, PyObject *Py_UNUSED(names))
{
    VersionFilter *filter = (VersionFilter *)self;
    unsigned long long node;
    const char *topic, *hashes;
    Py_ssize_t length;
    int hashless, only;
    if (!PyArg_ParseTuple(args, "Ksy#pp", &node, &topic, &hashes, &length, &hashless, &only)) {
        return -1;
    }
    filter->base.object.table = by_version;
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

static int list_init(PyObject *self, PyObject *Py_UNUSED(args), PyObject *Py_UNUSED(names))
{
    ListFilter *filter = (ListFilter *)self;
    filter->base.object.table = by_list;
    filter->lock = PyThread_allocate_lock();
    if (filter->lock == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    return 0;
}

static PyObject *list_restrict(PyObject *self, PyObject *args)
{
    ListFilter *filter = (ListFilter *)self;
    const char *gids;
    Py_ssize_t length;
    if (!PyArg_ParseTuple(args, "y#", &gids, &length)) {
        return NULL;
    }
    uint8_t *copy = malloc((size_t)length + 1), *previous = filter->gids;
    if (copy == NULL) {
        return PyErr_NoMemory();
    }
    memcpy(copy, gids, (size_t)length);
    PyThread_acquire_lock(filter->lock, WAIT_LOCK);
    filter->gids = copy;
    filter->count = (size_t)length / GID_BYTES;
    PyThread_release_lock(filter->lock);
    free(previous);
    Py_RETURN_NONE;
}

static void release_filter(PyObject *self)
{
    PyTypeObject *type = Py_TYPE(self);
    freefunc release = (freefunc)PyType_GetSlot(type, Py_tp_free);
    release(self);
    Py_DECREF(type);
}

static void version_dealloc(PyObject *self)
{
    VersionFilter *filter = (VersionFilter *)self;
    free(filter->topic);
    free(filter->hashes);
    if (filter->lock != NULL) {
        PyThread_free_lock(filter->lock);
    }
    release_filter(self);
}

static void list_dealloc(PyObject *self)
{
    ListFilter *filter = (ListFilter *)self;
    free(filter->gids);
    if (filter->lock != NULL) {
        PyThread_free_lock(filter->lock);
    }
    release_filter(self);
}

#define ATTACH                                                                                                         \
    {"attach", filter_attach, METH_VARARGS,                                                                            \
     "Filter what the reliable writer with this GID sends, until it is destroyed; return whether there is one."}

static PyMethodDef version_methods[] = {ATTACH, {NULL, NULL, 0, NULL}};

static PyMethodDef list_methods[] = {
    ATTACH,
    {"restrict", list_restrict, METH_VARARGS, "Send to the readers with these GIDs only, which are joined."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot version_slots[] = {
    {Py_tp_init, version_init}, {Py_tp_new, PyType_GenericNew}, {Py_tp_dealloc, version_dealloc},
    {Py_tp_methods, version_methods}, {0, NULL},
};

static PyType_Slot list_slots[] = {
    {Py_tp_init, list_init}, {Py_tp_new, PyType_GenericNew}, {Py_tp_dealloc, list_dealloc},
    {Py_tp_methods, list_methods}, {0, NULL},
};

static PyType_Spec specs[] = {
    {"bridge.adapters.ros2.reader_filter.VersionFilter", sizeof(VersionFilter), 0, Py_TPFLAGS_DEFAULT, version_slots},
    {"bridge.adapters.ros2.reader_filter.ListFilter", sizeof(ListFilter), 0, Py_TPFLAGS_DEFAULT, list_slots},
};
static const char *const names[] = {"VersionFilter", "ListFilter"};

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
    PyModuleDef_HEAD_INIT, .m_name = "reader_filter", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit_reader_filter(void)
{
    PyObject *made = PyModule_Create(&module);
    for (int at = 0; at < 2 && made != NULL; at++) {
        PyObject *type = PyType_FromSpec(&specs[at]);
        if (type == NULL || PyModule_AddObjectRef(made, names[at], type) < 0) {
            Py_CLEAR(made);
        }
        Py_XDECREF(type);
    }
    return made;
}

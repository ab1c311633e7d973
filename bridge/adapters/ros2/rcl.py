"""Calls of rcl that rclpy does not offer, through ctypes.

The structures are those in the headers of all releases in `bridge.adapters.ros2.releases` (rcutils/types/uint8_array.h,
rmw/types.h). A call through `_rcl_held` keeps the GIL; it is for calls of a few microseconds, for which releasing the
GIL would cost more than the call. No Python code runs on a thread of the middleware: its callbacks are C, in
``taking.c`` and ``service_callbacks.c``.
"""

from __future__ import annotations

import ctypes
import functools
import struct
from collections.abc import Callable
from ctypes import (
    CDLL,
    POINTER,
    PyDLL,
    Structure,
    byref,
    c_bool,
    c_char_p,
    c_int,
    c_int32,
    c_int64,
    c_size_t,
    c_ubyte,
    c_void_p,
    cast,
    create_string_buffer,
)
from typing import Any, NamedTuple

from bridge.adapters.ros2.releases import current
from bridge.adapters.ros2.tracing import allow_tracing_if_room
from bridge.hub.lane.joining import flush_joined
from bridge.kernels import CURE
from bridge.messages.errors import MessageTypeError

try:
    from bridge.adapters.ros2 import service_callbacks, taking
except ImportError:  # set up without a compiler
    service_callbacks = taking = None  # type: ignore[assignment]
try:
    from bridge.adapters.ros2.topics import writing
except ImportError:
    writing = None  # type: ignore[assignment]

RET_OK = 0
RET_TAKE_FAILED = 401
"""``RCL_RET_SUBSCRIPTION_TAKE_FAILED``: the subscription has no message."""

LARGE = 32 * 1024
"""Size in bytes from which a message's call releases the GIL, so that copying it does not stop the other threads."""

_GID_BYTES = 16


class _Allocator(Structure):
    _fields_ = [(name, c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")]


class _Bytes(Structure):
    _fields_ = [("buffer", c_void_p), ("length", c_size_t), ("capacity", c_size_t), ("allocator", _Allocator)]


class _Content(Structure):
    """The structure of `_Bytes` over a Python object that outlives the call."""

    _fields_ = [("buffer", c_char_p), ("length", c_size_t), ("capacity", c_size_t), ("allocator", _Allocator)]


_INFO = struct.Struct(f"@qqQQP{_GID_BYTES}s?0P")
"""``rmw_message_info_t``: source and reception time stamp, publication and reception sequence number, implementation
identifier, GID, whether from this process. Reading single fields would cost more than the take."""


allow_tracing_if_room()
_rcl = CDLL("librcl.so")
_rcl_held = PyDLL("librcl.so")
_rcutils = CDLL("librcutils.so")
_libc = CDLL(None)


def _address(function: Any) -> int:
    address = cast(function, c_void_p).value
    assert address is not None
    return address


def _declare(function: Any, result: Any, *arguments: Any) -> None:
    function.restype, function.argtypes = result, arguments


for _library in (_rcl, _rcl_held):
    _declare(_library.rcl_take_serialized_message, c_int32, c_void_p, POINTER(_Bytes), c_void_p, c_void_p)
    _declare(_library.rcl_publish_serialized_message, c_int32, c_void_p, POINTER(_Content), c_void_p)
_declare(_rcl.rcl_publisher_get_subscription_count, c_int32, c_void_p, POINTER(c_size_t))
_declare(_rcl.rcl_node_get_graph_guard_condition, c_void_p, c_void_p)
_declare(_rcl.rcl_wait_set_add_guard_condition, c_int32, c_void_p, c_void_p, c_void_p)
_declare(_rcutils.rcutils_get_default_allocator, _Allocator)
_declare(_rcutils.rcutils_uint8_array_fini, c_int, POINTER(_Bytes))
_declare(_rcutils.rcutils_reset_error, None)

_NEW_CALLBACK = {
    "subscription": _rcl.rcl_subscription_set_on_new_message_callback,
    "client": _rcl.rcl_client_set_on_new_response_callback,
    "service": _rcl.rcl_service_set_on_new_request_callback,
}
for _function in _NEW_CALLBACK.values():
    _declare(_function, c_int32, c_void_p, c_void_p, c_void_p)


_PUBLISH = _address(_rcl.rcl_publish_serialized_message)
_RESET_ERROR = _address(_rcutils.rcutils_reset_error)


def reset_error() -> None:
    """Delete the text of the last error of rcl in this thread."""
    _rcutils.rcutils_reset_error()


class RclError(RuntimeError):
    """A call into rcl failed."""

    def __init__(self, call: str, code: int) -> None:
        super().__init__(f"{call} failed with code {code} (rcl/types.h)")
        reset_error()


class Taken(NamedTuple):
    """One message as received: CDR with its encapsulation header, exactly as long as it was sent.

    ``gid`` is 16 bytes, the first 12 its participant's GUID prefix; ``source_ns`` is the publisher's time on the system
    clock, ``sequence`` the publisher's number of the message.
    """

    payload: bytes
    gid: bytes
    source_ns: int
    sequence: int


class Taker:
    """Takes serialized messages into a reused buffer; not thread-safe.

    Args:
        resolve: returns a publisher's GUID for the GID that rmw reports; None if they are the same.

    Attributes:
        buffer: a reference to the ``rmw_serialized_message_t``.
        info: the ``rmw_message_info_t``.
    """

    def __init__(self, resolve: Callable[[bytes], bytes] | None = None) -> None:
        self._resolve = resolve
        self._bytes = _Bytes(None, 0, 0, _rcutils.rcutils_get_default_allocator())
        self.info = create_string_buffer(_INFO.size)
        self.buffer = byref(self._bytes)

    def take(self, subscription: int, *, large: bool) -> Taken | None:
        """Return the next message of ``rcl_subscription_t *``, or None; ``large`` releases the GIL (`LARGE`)."""
        take = (_rcl if large else _rcl_held).rcl_take_serialized_message
        code = take(subscription, self.buffer, self.info, None)
        if code != RET_OK:
            reset_error()
            if code == RET_TAKE_FAILED:
                return None
            raise RclError("rcl_take_serialized_message", code)
        source_ns, _, sequence, _, _, gid, _ = _INFO.unpack(self.info)
        return Taken(self.payload(), gid if self._resolve is None else self._resolve(gid), source_ns, sequence)

    def taken(self) -> Taken:
        """Return the message that was last taken into `buffer` and `info` (`take` includes this)."""
        source_ns, _, sequence, _, _, gid, _ = _INFO.unpack(self.info)
        return Taken(self.payload(), gid if self._resolve is None else self._resolve(gid), source_ns, sequence)

    def payload(self) -> bytes:
        """Return a copy of the last message."""
        return ctypes.string_at(self._bytes.buffer, self._bytes.length)

    def close(self) -> None:
        _rcutils.rcutils_uint8_array_fini(self.buffer)


def publish(publisher: int, payload: bytes | memoryview) -> None:
    """Publish CDR bytes through ``rcl_publisher_t *``."""
    code = _publish(_PUBLISH, publisher, payload, LARGE)
    if code != RET_OK:
        raise RclError("rcl_publish_serialized_message", code)


def _publish_by_ctypes(_function: int, publisher: int, payload: bytes | memoryview, large: int) -> int:
    """Publish as `taking.publish` does."""
    payload, size = bytes(payload), len(payload)
    library = _rcl if size >= large else _rcl_held
    return int(library.rcl_publish_serialized_message(publisher, byref(_Content(payload, size, size)), None))


_publish = _publish_by_ctypes if taking is None else taking.publish


def new_writer(publisher: int, locked: Callable[[], bool]) -> writing.Writer | None:
    """Return what publishes through ``rcl_publisher_t *`` in C, while ``locked`` returns False; None: no compiler."""
    return None if writing is None else writing.Writer(_PUBLISH, _RESET_ERROR, publisher, LARGE, (locked,))


def serialized(payload: bytes) -> Any:
    """Return a reference to the ``rmw_serialized_message_t`` of CDR bytes, which must outlive the call."""
    return byref(_Content(payload, len(payload), len(payload)))


def reader_count(publisher: int) -> int:
    """Return how many readers ``rcl_publisher_t *`` has matched."""
    count = c_size_t()
    code = _rcl.rcl_publisher_get_subscription_count(publisher, byref(count))
    _check("rcl_publisher_get_subscription_count", code)
    return count.value


def _check(call: str, code: int) -> None:
    if code != RET_OK:
        raise RclError(call, code)


def is_compiled() -> bool:
    """Return whether the C extensions are compiled: the queue that takes messages, and the functions for services."""
    return service_callbacks is not None


class Waker(NamedTuple):
    """The address of an ``rcl_event_callback_t``, and its data."""

    callback: int
    data: int


def wake(kind: str, pointer: int, waker: Waker | None) -> None:
    """Report each new message, reply or request of an endpoint to a waker; with None, stop that before returning.

    ``kind`` is ``subscription``, ``client`` or ``service``; ``pointer`` is ``rcl_subscription_t *``,
    ``rcl_client_t *`` or ``rcl_service_t *``.
    """
    _check(f"waking by the {kind}", _NEW_CALLBACK[kind](pointer, *(waker or (None, None))))


def new_queue() -> taking.Queue:
    """Return a queue of readers with new messages; it needs the compiled extensions."""
    functions = (
        _rcl.rcl_take_serialized_message, _rcl.rcl_take, _rcutils.rcutils_reset_error,
        _rcutils.rcutils_get_default_allocator,
    )  # fmt: skip
    take_serialized, take, reset_error, default_allocator = map(_address, functions)
    return taking.Queue(take_serialized, take, reset_error, default_allocator, LARGE, flush_joined)


def queue_waker(data: int) -> Waker:
    """Return the waker that adds a reader to its queue; ``data`` is what the queue returned for the reader."""
    return Waker(taking.ON_NEW_MESSAGES, data)


def graph_guard_condition(node: int) -> int:
    """Return the ``rcl_guard_condition_t *`` of ``rcl_node_t *`` that triggers when the graph changes."""
    pointer = _rcl.rcl_node_get_graph_guard_condition(node)
    if not pointer:
        raise RclError("rcl_node_get_graph_guard_condition", -1)
    return int(pointer)


def wait_set_add_guard_condition(wait_set: int, guard_condition: int) -> None:
    """Add ``rcl_guard_condition_t *`` to ``rcl_wait_set_t *``."""
    code = _rcl.rcl_wait_set_add_guard_condition(wait_set, guard_condition, None)
    _check("rcl_wait_set_add_guard_condition", code)


@functools.cache
def host_prefix() -> bytes:
    """Return the four bytes with which Fast DDS begins the GUID prefix of every participant of this host.

    They do not change while the process runs. Each call of Fast DDS reserves a participant's number for good.

    Fast DDS recognizes neighbors (for shared memory) by them: vendor 01.0f and two bytes made of the host's addresses.
    An internal function of Fast DDS returns them. If the installed version lacks that function, the result is the
    vendor's two bytes and zeros, and Fast DDS merely does not recognize its neighbors.
    """
    guid = (c_ubyte * _GID_BYTES)()
    participant = c_int32(-1)
    try:
        release = current()
        create = getattr(CDLL(release.library), release.new_guid)
    except (OSError, AttributeError):
        return b"\x01\x0f\x00\x00"
    _declare(create, c_bool, POINTER(c_int32), POINTER(c_ubyte * _GID_BYTES))
    create(byref(participant), byref(guid))
    return bytes(guid)[:4]


# -- requests and replies as bytes -------------------------------------------------------------------------------------
# rmw has raw topics but no raw services: it passes a C structure to the type support's serializer, and lets its
# deserializer fill one. Here the structure is a `Wire`, a buffer in memory, and the two functions copy bytes from or to
# it. They are C (service_callbacks.c) without Python: the serializer runs while Fast DDS holds a writer's lock, and if
# it waited for the GIL there, a thread that creates an endpoint could deadlock.
#
# The functions' signatures are those of rosidl_typesupport_fastrtps_cpp/message_type_support.h (Jazzy). They use the
# public members of Fast CDR 2's ``Cdr``, and the offset of its iterators, which `end_of` searches for.

ENCAPSULATION = b"\x00\x01\x00\x00"
"""The header that rmw writes before a message: plain CDR, little-endian."""

NOT_COMPILED = (
    "ROS 2 services and actions are not bridged: the extension for their bytes (service_callbacks) is not compiled"
)

_MAX_REUSED = 64 * 1024
"""Maximum size of a reused buffer in bytes; a larger buffer is freed after each message."""

_APPEND = "_ZN8eprosima7fastcdr3Cdr15serialize_arrayEPKcm"
_BEGIN = "_ZN8eprosima7fastcdr3Cdr18get_buffer_pointerEv"


class Wire(Structure):
    """A whole message in memory; for a taken message libc allocates ``capacity`` bytes, which grow as needed.

    A taken message of ``exact_length`` bytes goes to ``exact`` instead (``taking.c``).
    """

    _fields_ = [
        ("start", c_void_p),
        ("length", c_size_t),
        ("capacity", c_size_t),
        ("exact", c_void_p),
        ("exact_length", c_size_t),
    ]


def outgoing(payload: bytes) -> Wire:
    """Return a message for rmw to send; ``payload`` must outlive the call."""
    return Wire(cast(c_char_p(payload), c_void_p), len(payload), 0)


class Incoming:
    """A reused buffer for the messages that rmw takes; not thread-safe."""

    def __init__(self) -> None:
        self._wire = Wire(None, 0, 0)
        self.pointer = ctypes.addressof(self._wire)

    def payload(self) -> bytes:
        """Return a copy of the last message."""
        payload = ctypes.string_at(self._wire.start or 0, self._wire.length)
        if self._wire.capacity > _MAX_REUSED:
            self.close()
        return payload

    def close(self) -> None:
        _libc.free(c_void_p(self._wire.start))
        self._wire.start, self._wire.capacity = None, 0


class Callbacks:
    """The addresses of the compiled functions for all services; raises `MessageTypeError` if not compiled."""

    def __init__(self) -> None:
        if service_callbacks is None:
            raise MessageTypeError(NOT_COMPILED, CURE)
        library = ctypes.CDLL("libfastcdr.so.2")
        append, begin = (_address(getattr(library, name)) for name in (_APPEND, _BEGIN))
        self.serialize, self.deserialize, self.size = service_callbacks.addresses(append, begin)


# -- services ----------------------------------------------------------------------------------------------------------
# All of these release the GIL: rmw may wait up to 0.1 s for a client that it has discovered only in part.

_CLIENT_TAKE_FAILED, _SERVICE_TAKE_FAILED = 501, 601
_TIMEOUT = 2
_REQUEST_ID = struct.Struct(f"@{_GID_BYTES}sq")
"""``rmw_request_id_t``: GID, sequence number."""

_declare(_rcl.rcl_send_request, c_int32, c_void_p, POINTER(Wire), POINTER(c_int64))
_declare(_rcl.rcl_take_response, c_int32, c_void_p, c_void_p, c_void_p)
_declare(_rcl.rcl_take_request, c_int32, c_void_p, c_void_p, c_void_p)
_declare(_rcl.rcl_send_response, c_int32, c_void_p, c_void_p, POINTER(Wire))
_declare(_rcl.rcl_service_server_is_available, c_int32, c_void_p, c_void_p, POINTER(c_bool))


class RequestId(NamedTuple):
    """The id of a request: its client's GID, by which the reply is routed, and its number."""

    gid: bytes
    number: int


class CallTaker:
    """Takes requests and replies; not thread-safe."""

    def __init__(self) -> None:
        self._incoming = Incoming()
        self._id = create_string_buffer(_REQUEST_ID.size)

    def request(self, service: int) -> tuple[RequestId, bytes] | None:
        """Return the next request of ``rcl_service_t *``, or None."""
        code = _rcl.rcl_take_request(service, self._id, self._incoming.pointer)
        return self._taken("rcl_take_request", code, _SERVICE_TAKE_FAILED)

    def response(self, client: int) -> tuple[RequestId, bytes] | None:
        """Return the next reply to ``rcl_client_t *``, or None."""
        code = _rcl.rcl_take_response(client, self._id, self._incoming.pointer)
        return self._taken("rcl_take_response", code, _CLIENT_TAKE_FAILED)

    def _taken(self, call: str, code: int, nothing: int) -> tuple[RequestId, bytes] | None:
        if code == RET_OK:
            return RequestId(*_REQUEST_ID.unpack(self._id.raw)), self._incoming.payload()
        reset_error()
        if code == nothing:
            return None
        raise RclError(call, code)

    def close(self) -> None:
        self._incoming.close()


def send_request(client: int, payload: bytes) -> int:
    """Send CDR bytes through ``rcl_client_t *``; return the request's number."""
    number = c_int64()
    _check("rcl_send_request", _rcl.rcl_send_request(client, byref(outgoing(payload)), byref(number)))
    return number.value


def send_response(service: int, request: RequestId, payload: bytes) -> bool:
    """Send CDR bytes through ``rcl_service_t *``; return False if the client is unreachable."""
    name = create_string_buffer(_REQUEST_ID.pack(*request), _REQUEST_ID.size)
    code = _rcl.rcl_send_response(service, name, byref(outgoing(payload)))
    if code == _TIMEOUT:
        reset_error()
        return False
    _check("rcl_send_response", code)
    return True


def has_server(node: int, client: int) -> bool:
    """Return whether ``rcl_client_t *`` and a server have discovered each other."""
    available = c_bool()
    code = _rcl.rcl_service_server_is_available(node, client, byref(available))
    _check("rcl_service_server_is_available", code)
    return available.value

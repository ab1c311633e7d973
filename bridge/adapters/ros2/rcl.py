"""The calls of rcl that rclpy does not offer, by ctypes.

Structures as in Jazzy's headers (rcutils/types/uint8_array.h, rmw/types.h). A call through `_held` keeps the GIL: it is
for calls of a few microseconds, where giving the GIL away costs more than the call. Nothing of Python runs on a thread
of the middleware: the only callback that it is given is libc's ``eventfd_write``.
"""

from __future__ import annotations

import ctypes
import os
import struct
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
    c_size_t,
    c_ubyte,
    c_void_p,
    create_string_buffer,
)
from typing import NamedTuple

RET_OK = 0
RET_TAKE_FAILED = 401
"""``RCL_RET_SUBSCRIPTION_TAKE_FAILED``: nothing to take."""

LARGE = 32 * 1024
"""Bytes from which a call gives the GIL away, so that copying one large message does not stop the other threads."""

_GID_BYTES = 16


class _Allocator(Structure):
    _fields_ = [(name, c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")]


class _Bytes(Structure):
    _fields_ = [
        ("buffer", c_void_p),
        ("length", c_size_t),
        ("capacity", c_size_t),
        ("allocator", _Allocator),
    ]


class _Content(Structure):
    """The same, around a Python object that outlives the call."""

    _fields_ = [
        ("buffer", c_char_p),
        ("length", c_size_t),
        ("capacity", c_size_t),
        ("allocator", _Allocator),
    ]


_INFO = struct.Struct(f"@qqQQP{_GID_BYTES}s?0P")
"""``rmw_message_info_t``: source and reception time stamp, publication and reception sequence number, implementation
identifier, GID, whether from this process. Read in one go: field by field costs more than the take."""


_rcl = CDLL("librcl.so")
_rcl_held = PyDLL("librcl.so")
_rcutils = CDLL("librcutils.so")
_libc = CDLL(None)

for _library in (_rcl, _rcl_held):
    _library.rcl_take_serialized_message.argtypes = [c_void_p, POINTER(_Bytes), c_void_p, c_void_p]
    _library.rcl_take_serialized_message.restype = c_int32
    _library.rcl_publish_serialized_message.argtypes = [c_void_p, POINTER(_Content), c_void_p]
    _library.rcl_publish_serialized_message.restype = c_int32
_rcl.rcl_subscription_set_on_new_message_callback.argtypes = [c_void_p, c_void_p, c_void_p]
_rcl.rcl_subscription_set_on_new_message_callback.restype = c_int32
_rcl.rcl_node_get_graph_guard_condition.argtypes = [c_void_p]
_rcl.rcl_node_get_graph_guard_condition.restype = c_void_p
_rcl.rcl_wait_set_add_guard_condition.argtypes = [c_void_p, c_void_p, c_void_p]
_rcl.rcl_wait_set_add_guard_condition.restype = c_int32
_rcutils.rcutils_get_default_allocator.argtypes = []
_rcutils.rcutils_get_default_allocator.restype = _Allocator
_rcutils.rcutils_uint8_array_fini.argtypes = [POINTER(_Bytes)]
_rcutils.rcutils_uint8_array_fini.restype = c_int
_rcutils.rcutils_reset_error.argtypes = []
_rcutils.rcutils_reset_error.restype = None


def reset_error() -> None:
    """Have rcl forget the text of the last error of this thread."""
    _rcutils.rcutils_reset_error()


class RclError(RuntimeError):
    """A call into rcl failed."""

    def __init__(self, call: str, code: int) -> None:
        super().__init__(f"{call} failed with code {code} (rcl/types.h)")
        reset_error()


class Taken(NamedTuple):
    """One message as it came off the wire.

    Attributes:
        payload: CDR with its encapsulation header, exactly as long as it was sent.
        gid: 16 bytes; the first 12 are the GUID prefix of the participant that published it.
        source_ns: the publisher's time stamp, system clock.
        sequence: the publisher's number of the message.
    """

    payload: bytes
    gid: bytes
    source_ns: int
    sequence: int


class Taker:
    """Takes serialized messages; its buffer is used again and again. For one thread."""

    def __init__(self) -> None:
        self._bytes = _Bytes(None, 0, 0, _rcutils.rcutils_get_default_allocator())
        self._info = create_string_buffer(_INFO.size)
        self._bytes_ref = byref(self._bytes)

    def take(self, subscription: int, *, large: bool) -> Taken | None:
        """The next message of ``rcl_subscription_t *``, None where there is none; ``large``: as LARGE says."""
        take = (_rcl if large else _rcl_held).rcl_take_serialized_message
        code = take(subscription, self._bytes_ref, self._info, None)
        if code != RET_OK:
            reset_error()
            if code == RET_TAKE_FAILED:
                return None
            raise RclError("rcl_take_serialized_message", code)
        content = self._bytes
        payload = ctypes.string_at(content.buffer, content.length)
        source_ns, _, sequence, _, _, gid, _ = _INFO.unpack(self._info)
        return Taken(payload, gid, source_ns, sequence)

    def close(self) -> None:
        """Free the buffer."""
        _rcutils.rcutils_uint8_array_fini(self._bytes_ref)


def publish(publisher: int, payload: bytes) -> None:
    """Publish CDR bytes by ``rcl_publisher_t *``."""
    size = len(payload)
    content = _Content(payload, size, size)
    library = _rcl if size >= LARGE else _rcl_held
    code = library.rcl_publish_serialized_message(publisher, byref(content), None)
    if code != RET_OK:
        raise RclError("rcl_publish_serialized_message", code)


def wake_by_eventfd(subscription: int, descriptor: int | None) -> None:
    """Have each new message of ``rcl_subscription_t *`` counted in an eventfd; None ends it.

    After the call with None the middleware does not touch the descriptor any more.
    """
    callback = None if descriptor is None else ctypes.cast(_libc.eventfd_write, c_void_p)
    code = _rcl.rcl_subscription_set_on_new_message_callback(subscription, callback, descriptor)
    if code != RET_OK:
        raise RclError("rcl_subscription_set_on_new_message_callback", code)


def graph_guard_condition(node: int) -> int:
    """``rcl_guard_condition_t *`` of ``rcl_node_t *`` that triggers when the graph changes."""
    pointer = _rcl.rcl_node_get_graph_guard_condition(node)
    if not pointer:
        raise RclError("rcl_node_get_graph_guard_condition", -1)
    return int(pointer)


def wait_set_add_guard_condition(wait_set: int, guard_condition: int) -> None:
    """Add ``rcl_guard_condition_t *`` to ``rcl_wait_set_t *``."""
    code = _rcl.rcl_wait_set_add_guard_condition(wait_set, guard_condition, None)
    if code != RET_OK:
        raise RclError("rcl_wait_set_add_guard_condition", code)


def host_prefix() -> bytes:
    """The four bytes with which Fast DDS begins the GUID prefix of every participant of this host.

    Fast DDS takes nodes for neighbours (shared memory) by them: vendor 01.0f and two bytes made of the host's
    addresses. Asked of Fast DDS 2.14 itself; where another version has no such function, the vendor's two bytes and
    zeros, which costs nothing but the recognition of neighbours.
    """
    guid = (c_ubyte * _GID_BYTES)()
    participant = c_int32(-1)
    try:
        library = CDLL("libfastrtps.so.2.14")
        create = library._ZN8eprosima8fastrtps4rtps14RTPSDomainImpl23create_participant_guidERiRNS1_6GUID_tE
    except (OSError, AttributeError):
        return b"\x01\x0f\x00\x00"
    create.argtypes = [POINTER(c_int32), POINTER(c_ubyte * _GID_BYTES)]
    create.restype = c_bool
    create(byref(participant), byref(guid))
    return bytes(guid)[:4]


def has_eventfd() -> bool:
    """Whether the system has eventfd (Linux)."""
    return hasattr(os, "eventfd")

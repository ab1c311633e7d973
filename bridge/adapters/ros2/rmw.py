"""Calls of rmw that rcl does not offer, through ctypes, above all publishers and subscriptions of any DDS topic.

rcl adds a slash to every name, so it cannot subscribe to ``rr/lampReply``, the topic on which a service replies.
Structures as in Jazzy's rmw/types.h and rmw/qos_profiles.h.
"""

from __future__ import annotations

import os
from ctypes import (
    CDLL,
    POINTER,
    Structure,
    byref,
    c_bool,
    c_char_p,
    c_int,
    c_int32,
    c_size_t,
    c_ubyte,
    c_uint64,
    c_void_p,
    create_string_buffer,
)
from functools import cache
from typing import Any, Self

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.environment import FAST_DDS, RMW
from bridge.messages.errors import MessageTypeError

_KEEP_LAST, _RELIABLE, _VOLATILE = 1, 1, 2
_OPTIONS_BYTES = 64
"""More than the sizes of ``rmw_subscription_options_t`` and ``rmw_publisher_options_t``, whose defaults are zeros."""


class _Time(Structure):
    _fields_ = [("sec", c_uint64), ("nsec", c_uint64)]


class _QosProfile(Structure):
    _fields_ = [
        ("history", c_int), ("depth", c_size_t), ("reliability", c_int), ("durability", c_int), ("deadline", _Time),
        ("lifespan", _Time), ("liveliness", c_int), ("lease", _Time), ("avoid_ros_namespace_conventions", c_bool),
    ]  # fmt: skip


@cache
def _library() -> tuple[CDLL, CDLL]:
    """Return rcl and the worker's rmw; raises `OSError`, or `AttributeError` for an rmw without these functions."""
    of_rcl, rmw = CDLL("librcl.so"), CDLL(f"lib{os.environ.get(RMW, FAST_DDS)}.so")
    for handle in (of_rcl.rcl_node_get_rmw_handle, of_rcl.rcl_publisher_get_rmw_handle):
        handle.restype, handle.argtypes = c_void_p, [c_void_p]
    signatures: tuple[tuple[Any, Any, list[Any]], ...] = (
        (rmw.rmw_create_subscription, c_void_p, [c_void_p, c_void_p, c_char_p, c_void_p, c_void_p]),
        (rmw.rmw_get_gid_for_publisher, c_int32, [c_void_p, c_void_p]),
        (rmw.rmw_destroy_subscription, c_int32, [c_void_p, c_void_p]),
        (rmw.rmw_subscription_set_on_new_message_callback, c_int32, [c_void_p, c_void_p, c_void_p]),
        (rmw.rmw_subscription_count_matched_publishers, c_int32, [c_void_p, POINTER(c_size_t)]),
        (rmw.rmw_take_serialized_message, c_int32, [c_void_p, c_void_p, POINTER(c_bool), c_void_p]),
        (rmw.rmw_take_serialized_message_with_info, c_int32, [c_void_p, c_void_p, POINTER(c_bool), c_void_p, c_void_p]),
        (rmw.rmw_create_publisher, c_void_p, [c_void_p, c_void_p, c_char_p, c_void_p, c_void_p]),
        (rmw.rmw_publish_serialized_message, c_int32, [c_void_p, c_void_p, c_void_p]),
        (rmw.rmw_destroy_publisher, c_int32, [c_void_p, c_void_p]),
    )
    for function, result, arguments in signatures:
        function.restype, function.argtypes = result, arguments
    return of_rcl, rmw


class _Publisher(Structure):
    """The beginning of ``rmw_publisher_t``."""

    _fields_ = [("implementation", c_char_p), ("data", c_void_p)]


class _Gid(Structure):
    """``rmw_gid_t``."""

    _fields_ = [("implementation", c_char_p), ("data", c_ubyte * 16)]


def publisher_gid(publisher: int) -> bytes:
    """Return the GID of ``rcl_publisher_t *``, 16 bytes."""
    of_rcl, rmw = _library()
    gid = _Gid()
    code = rmw.rmw_get_gid_for_publisher(of_rcl.rcl_publisher_get_rmw_handle(publisher), byref(gid))
    if code != rcl.RET_OK:
        raise rcl.RclError("rmw_get_gid_for_publisher", code)
    return bytes(gid.data)


def _service_qos(depth: int) -> _QosProfile:
    return _QosProfile(_KEEP_LAST, depth, _RELIABLE, _VOLATILE, avoid_ros_namespace_conventions=True)


class RmwPublisher:
    """A reliable, volatile writer of a DDS topic.

    Raises `MessageTypeError` if the middleware refuses the writer.

    Args:
        node: the address of the ``rcl_node_t``.
        support: the address of the type support of the topic's messages.
        topic: the name of the DDS topic.
        depth: number of messages in the writer's history.

    Attributes:
        gid: the writer's GID.
        data: the address of the middleware's own structure for the writer (``rmw_publisher_t.data``).
    """

    def __init__(self, node: int, support: int, topic: str, depth: int) -> None:
        of_rcl, self._rmw = _library()
        self._node = of_rcl.rcl_node_get_rmw_handle(node)
        qos, options = _service_qos(depth), create_string_buffer(_OPTIONS_BYTES)
        pointer = self._rmw.rmw_create_publisher(self._node, support, topic.encode(), byref(qos), options)
        if not pointer:
            rcl.reset_error()
            raise MessageTypeError(f"ROS 2 does not accept a publisher of the DDS topic {topic}")
        self._pointer = int(pointer)
        gid = _Gid()
        self._rmw.rmw_get_gid_for_publisher(self._pointer, byref(gid))
        self.gid, self.data = bytes(gid.data), int(_Publisher.from_address(self._pointer).data)

    def publish(self, payload: bytes) -> None:
        """Publish CDR bytes; raises `RclError`."""
        code = self._rmw.rmw_publish_serialized_message(self._pointer, rcl.serialized(payload), None)
        if code != rcl.RET_OK:
            raise rcl.RclError("rmw_publish_serialized_message", code)

    def destroy(self) -> None:
        """Destroy it; nothing may use it afterwards."""
        self._rmw.rmw_destroy_publisher(self._node, self._pointer)


class RmwSubscription:
    """A reliable, volatile reader of a DDS topic; ``pointer`` is its ``rmw_subscription_t *``.

    It has those methods of the objects inside rclpy that `bridge.adapters.ros2.loop.EndpointReader` uses. Raises
    `MessageTypeError` if the middleware refuses it.

    Args:
        node: the address of the ``rcl_node_t``.
        support: the address of the type support of the topic's messages.
        topic: the name of the DDS topic.
        depth: number of messages in its history.
    """

    def __init__(self, node: int, support: int, topic: str, depth: int) -> None:
        of_rcl, self._rmw = _library()
        self._node = of_rcl.rcl_node_get_rmw_handle(node)
        qos = _service_qos(depth)
        options = create_string_buffer(_OPTIONS_BYTES)
        pointer = self._rmw.rmw_create_subscription(self._node, support, topic.encode(), byref(qos), options)
        if not pointer:
            rcl.reset_error()
            raise MessageTypeError(f"ROS 2 does not accept a subscription of the DDS topic {topic}")
        self.pointer = int(pointer)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def destroy_when_not_in_use(self) -> None:
        """Destroy it: unlike rclpy's objects it has one user, which calls this last."""
        self._rmw.rmw_destroy_subscription(self._node, self.pointer)

    def wake(self, waker: rcl.Waker | None) -> None:
        """Report each new message to a waker; with None, stop that before returning."""
        code = self._rmw.rmw_subscription_set_on_new_message_callback(self.pointer, *(waker or (None, None)))
        if code != rcl.RET_OK:
            raise rcl.RclError("rmw_subscription_set_on_new_message_callback", code)

    def matched(self) -> int:
        """Return the number of writers that are matched."""
        count = c_size_t()
        self._rmw.rmw_subscription_count_matched_publishers(self.pointer, byref(count))
        return count.value

    def take(self, taker: rcl.Taker) -> bytes | None:
        """Return the next message as CDR, or None."""
        taken = c_bool()
        code = self._rmw.rmw_take_serialized_message(self.pointer, taker.buffer, byref(taken), None)
        if code != rcl.RET_OK:
            raise rcl.RclError("rmw_take_serialized_message", code)
        return taker.payload() if taken.value else None

    def take_with_gid(self, taker: rcl.Taker) -> rcl.Taken | None:
        """Return the next message with its publisher's GID, or None."""
        taken = c_bool()
        code = self._rmw.rmw_take_serialized_message_with_info(
            self.pointer, taker.buffer, byref(taken), taker.info, None
        )
        if code != rcl.RET_OK:
            raise rcl.RclError("rmw_take_serialized_message_with_info", code)
        return taker.taken() if taken.value else None


Topic = tuple[int, str]
"""The address of the type support of a DDS topic's messages, and its name."""

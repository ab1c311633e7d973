"""Filters that restrict DDS writers to some of the readers that have matched.

DDS matches endpoints by the name of their type, so a writer reaches the subscriptions of all versions of a type, and a
client the servers of all versions and vendors. Fast DDS has a filter for each writer, which is C here
(``reader_filter.c``), as it runs on Fast DDS's threads.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from ctypes import CDLL, addressof, c_char, c_void_p, cast
from functools import cache

from bridge.adapters.ros2 import rmw
from bridge.adapters.ros2.releases import current
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.releases import NO_HASH

try:
    from bridge.adapters.ros2 import reader_filter
except ImportError:  # set up without a compiler
    reader_filter = None  # type: ignore[assignment]

_HASH_PREFIX = "RIHS01_"


@cache
def is_available() -> bool:
    """Return whether writers can be restricted: the extension is compiled, and this Fast DDS has the functions."""
    if reader_filter is None:
        return False
    try:
        table, *functions = current().writer_filter
        fast_dds, rcutils = CDLL(current().library), CDLL("librcutils.so")
        calls = (
            *(getattr(fast_dds, name) for name in functions),
            CDLL("librcl.so").rcl_get_subscriptions_info_by_topic,
            CDLL("librmw.so").rmw_topic_endpoint_info_array_fini,
            rcutils.rcutils_reset_error,
            rcutils.rcutils_get_default_allocator,
        )
        virtual_functions = addressof(c_char.in_dll(fast_dds, table))
    except (OSError, AttributeError, ValueError):
        return False
    reader_filter.configure(virtual_functions, *(cast(call, c_void_p).value or 0 for call in calls))
    return True


class VersionFilter:
    """Restricts writers of a topic to the subscriptions of the given versions, or to all others.

    Args:
        node: the address of the ``rcl_node_t``.
        topic: the name of the topic.
        versions: hashes; `NO_HASH` stands for ROS 2 programs that announce none.
        only: whether the writers send to these versions only, or to all others.
    """

    def __init__(self, node: int, topic: str, versions: Collection[str], *, only: bool) -> None:
        hashes = b"".join(bytes.fromhex(v.removeprefix(_HASH_PREFIX)) for v in versions if v != NO_HASH)
        self._topic, self._arguments = topic, (node, topic, hashes, NO_HASH in versions, only)

    def attach(self, publisher: int) -> object:
        """Restrict the writer of ``rcl_publisher_t *``; keep the result until the writer is destroyed.

        Raises `MessageTypeError` if Fast DDS has no such writer, or the writer is not reliable.
        """
        attached = reader_filter.VersionFilter(*self._arguments)
        if not attached.attach(rmw.publisher_gid(publisher)):
            raise MessageTypeError(f"{self._topic}: Fast DDS does not filter the messages of its writer by version")
        return attached


class ListFilter:
    """Restricts a client's request writer to some servers; at first to none.

    Keep it until the writer is destroyed. Raises `MessageTypeError` if Fast DDS does not have the writer.

    Args:
        service: the service's name.
        writer: the writer's GID.
    """

    def __init__(self, service: str, writer: bytes) -> None:
        self._filter = reader_filter.ListFilter()
        if not self._filter.attach(writer):
            raise MessageTypeError(f"{service}: Fast DDS does not filter the requests of its client by server")

    def restrict(self, servers: Iterable[bytes]) -> None:
        """Send the next requests to the servers whose readers have these GIDs."""
        self._filter.restrict(b"".join(servers))

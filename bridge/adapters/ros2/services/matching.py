"""Queries Fast DDS for the number of peers that a client's or a server's writer has matched."""

from __future__ import annotations

import ctypes
from ctypes import CDLL, c_int32, c_void_p
from functools import cache
from typing import Any, NamedTuple

_WRITERS = {
    "client": "_ZN16rmw_fastrtps_cpp22get_request_datawriterEP12rmw_client_s",
    "service": "_ZN16rmw_fastrtps_cpp23get_response_datawriterEP13rmw_service_s",
}
_GET_STATUS = "_ZNK8eprosima7fastdds3dds10DataWriter30get_publication_matched_statusERNS1_24PublicationMatchedStatusE"

_STATUS_BYTES = 128
"""More than the size of ``PublicationMatchedStatus``, which begins with four integers of 32 bits: ``total_count``, its
change, ``current_count``, its change."""


class _Functions(NamedTuple):
    """By kind, the functions that return the rmw handle and the writer; and the function that returns the status."""

    handles: dict[str, Any]
    writers: dict[str, Any]
    status: Any


@cache
def _functions() -> _Functions | None:
    try:
        rcl, rmw = CDLL("librcl.so"), CDLL("librmw_fastrtps_cpp.so")
        handles = {kind: getattr(rcl, f"rcl_{kind}_get_rmw_handle") for kind in _WRITERS}
        writers = {kind: getattr(rmw, symbol) for kind, symbol in _WRITERS.items()}
        status = getattr(rmw, _GET_STATUS)
    except (OSError, AttributeError):
        return None
    for function in (*handles.values(), *writers.values()):
        function.restype, function.argtypes = c_void_p, [c_void_p]
    status.restype, status.argtypes = c_int32, [c_void_p, c_void_p]
    return _Functions(handles, writers, status)


class MatchCounter:
    """Counts the peers that the writer of a client (``rcl_client_t *``) or a service (``rcl_service_t *``) has matched.

    Discovery updates the graph before the writer. So while the total of a client stays the same, no server has appeared
    since the graph was last read. Reading a count takes a few microseconds, regardless of the size of the graph.
    """

    def __init__(self, pointer: int, kind: str) -> None:
        self._writer: int | None = None
        functions = _functions()
        if functions is not None:
            self._status = functions.status
            self._writer = functions.writers[kind](functions.handles[kind](pointer))
            self._buffer = ctypes.create_string_buffer(_STATUS_BYTES)

    def total(self) -> int | None:
        """Return how many peers have matched so far, which never decreases; None if it is not available."""
        return self._count(0)

    def current(self) -> int | None:
        """Return how many peers are matched now; None if it is not available."""
        return self._count(2)

    def _count(self, position: int) -> int | None:
        if not self._writer or self._status(self._writer, self._buffer):
            return None
        return int.from_bytes(self._buffer.raw[4 * position : 4 * position + 4], "little")

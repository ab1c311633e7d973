"""Queries Fast DDS for the number of servers that a client's request writer has matched."""

from __future__ import annotations

import ctypes
from ctypes import CDLL, c_int32, c_void_p
from typing import Any

_GET_WRITER = "_ZN16rmw_fastrtps_cpp22get_request_datawriterEP12rmw_client_s"
_GET_STATUS = "_ZNK8eprosima7fastdds3dds10DataWriter30get_publication_matched_statusERNS1_24PublicationMatchedStatusE"

_STATUS_BYTES = 128
"""More than the size of ``PublicationMatchedStatus``; its first field is ``total_count``, 32 bits."""


def _functions() -> tuple[Any, Any, Any] | None:
    try:
        rcl, rmw = CDLL("librcl.so"), CDLL("librmw_fastrtps_cpp.so")
        handle, writer, status = rcl.rcl_client_get_rmw_handle, getattr(rmw, _GET_WRITER), getattr(rmw, _GET_STATUS)
    except (OSError, AttributeError):
        return None
    for function in (handle, writer):
        function.restype, function.argtypes = c_void_p, [c_void_p]
    status.restype, status.argtypes = c_int32, [c_void_p, c_void_p]
    return handle, writer, status


_FUNCTIONS = _functions()


class MatchCounter:
    """Counts the servers that ``rcl_client_t *`` has matched so far.

    Discovery updates the graph before the writer. So while the count stays the same, no server has appeared since the
    graph was last read. Reading the count takes some microseconds, regardless of the size of the graph.
    """

    def __init__(self, client: int) -> None:
        self._writer: int | None = None
        if _FUNCTIONS is not None:
            handle, writer, self._status = _FUNCTIONS
            self._writer = writer(handle(client))
            self._buffer = ctypes.create_string_buffer(_STATUS_BYTES)

    def total(self) -> int | None:
        """Return the count, which never decreases; None if the middleware does not provide it."""
        if not self._writer or self._status(self._writer, self._buffer):
            return None
        return int.from_bytes(self._buffer.raw[:4], "little")

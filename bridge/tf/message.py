# cython: cdivision=True
"""Reads transforms directly from the bytes of a ``tf2_msgs/msg/TFMessage``, without a Python object for each part.

This is a kernel, compiled by Cython (`bridge.kernels`). In compiled code ``source`` is a pointer, otherwise the bytes
object. Every read is checked against the end of the message in advance.
"""

from __future__ import annotations

import cython

Span = tuple[int, bytes, int]
"""One transform: its stamp in ns, its two names as encoded in the message, and the byte at which its pose begins."""

_POSE = cython.declare(cython.Py_ssize_t, 56)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _load32(source: cython.p_const_uchar, at: cython.Py_ssize_t) -> cython.longlong:
    high: cython.longlong = source[at + 3]
    return source[at] | (source[at + 1] << 8) | (source[at + 2] << 16) | (high << 24)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _behind_string(source: cython.p_const_uchar, at: cython.Py_ssize_t, size: cython.Py_ssize_t) -> cython.Py_ssize_t:
    """Return the end of the string whose length is at ``at``, after its NUL; -1 if it is not within the message."""
    if at + 4 > size:
        return -1
    length: cython.Py_ssize_t = _load32(source, at)
    if length > size - at - 4 or (length > 0 and source[at + 3 + length] != 0):
        return -1
    return at + 4 + length


def read(cdr: bytes) -> list[Span]:
    """Parse a message; raises `ValueError` if the bytes are not one.

    Args:
        cdr: the message with its encapsulation header of 4 bytes, after which everything is aligned.
    """
    source: cython.p_const_uchar = cdr
    size: cython.Py_ssize_t = len(cdr)
    spans: list[Span] = []
    if size < 8 or source[0] != 0 or source[1] != 1:
        raise _refused(size)
    at: cython.Py_ssize_t = 8
    cython.declare(seconds=cython.longlong, nanoseconds=cython.longlong)
    cython.declare(parent=cython.Py_ssize_t, child=cython.Py_ssize_t, end=cython.Py_ssize_t)
    for _ in range(_load32(source, 4)):
        at = (at + 3) & ~3
        if at + 8 > size:
            raise _refused(size)
        seconds, nanoseconds = _load32(source, at), _load32(source, at + 4)
        if seconds >= 1 << 31:
            seconds -= 1 << 32
        parent = at + 8
        child = _behind_string(source, parent, size)
        if child < 0:
            raise _refused(size)
        child = (child + 3) & ~3
        end = _behind_string(source, child, size)
        if end < 0:
            raise _refused(size)
        names = cdr[parent : end - (end > child + 4)]
        at = ((end + 3) & ~7) + 4
        if at + _POSE > size:
            raise _refused(size)
        spans.append((seconds * 1_000_000_000 + nanoseconds, names, at))
        at += _POSE
    return spans


def split_names(names: bytes) -> tuple[str, str]:
    """Decode the names of parent and child from those of a `Span`."""
    length = int.from_bytes(names[:4], "little")
    child = 8 + ((length + 3) & ~3)
    return str(names[4 : 4 + max(length - 1, 0)], "utf-8", "replace"), str(names[child:], "utf-8", "replace")


def _refused(size: int) -> ValueError:
    return ValueError(f"these {size} bytes are not a tf2_msgs/msg/TFMessage (CDR, little-endian)")

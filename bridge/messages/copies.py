"""Copies of large messages, made without the interpreter's lock (``buffers.c``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

try:
    from bridge.messages import buffers
except ImportError:  # there was no compiler
    if not TYPE_CHECKING:
        buffers = None

__all__ = ["buffers", "copied", "copy_to"]


def copied(view: memoryview) -> bytes:
    """Return a copy of a buffer."""
    return bytes(view) if buffers is None else buffers.converted(None, view, len(view), True)


def copy_to(message: bytes, place: memoryview) -> None:
    """Copy a message into a buffer of its size."""
    if buffers is None:
        place[:] = message
    else:
        buffers.write_to(None, message, len(message), True, place)

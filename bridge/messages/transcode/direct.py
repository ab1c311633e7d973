"""Converts large messages that other processes share, from or to their memory (``buffers.c``)."""

from __future__ import annotations

from collections.abc import Callable

from bridge.messages.copies import buffers, copied
from bridge.messages.transcode.conversion import Convert, native_program


class DirectConversion:
    """A conversion between buffers, without copies in between; ``convert`` is None if the bytes stay the same.

    Without a compiler, or if the conversion needs Python, it makes the copies that it otherwise avoids.
    """

    def __init__(self, convert: Convert | None) -> None:
        self._convert = convert
        self._native = None if convert is None else native_program(convert)
        self._direct = buffers is not None and (convert is None or self._native is not None)

    def write(self, message: bytes, room: Callable[[int], memoryview | None]) -> bytes | None:
        """Write the converted message into ``room(size)``, and return None; return it if that is impossible.

        Raises `bridge.messages.errors.ConversionError`.
        """
        measured = buffers.measured(self._native, message) if self._direct else None
        place = None if measured is None else room(measured[0])
        if measured is None or place is None:
            return message if self._convert is None else self._convert(message)
        buffers.write_to(self._native, message, *measured, place)
        return None

    def read(self, message: memoryview) -> bytes | memoryview:
        """Return the converted message, as a part of ``message`` if its bytes stay the same.

        Raises `bridge.messages.errors.ConversionError`.
        """
        if self._convert is None:
            return message
        measured = buffers.measured(self._native, message) if self._direct else None
        if measured is None:
            return self._convert(copied(message))
        size, copies = measured
        return message[:size] if copies else buffers.converted(self._native, message, size, False)

"""Large messages that a lane's writer lends: the reader's end of `bridge.hub.lane.blocks`.

The writer, another worker of this daemon, does not write to a block until the reader has returned it. If the connection
ends, the writer never uses the block again, and it remains as long as the reader uses it.
"""

from __future__ import annotations

import errno
import logging
import mmap
import os
import time
from collections.abc import Callable
from threading import Lock

from bridge.hub.errors import HubWireError
from bridge.hub.lane.blocks import IDLE_SECONDS, POSSIBLE
from bridge.messages.copies import copied

_log = logging.getLogger(__name__)

MAX_MAPPED = 128 << 20
"""Maximum number of bytes of one writer's blocks that stay mapped, except for the newest one."""

MAX_MAPPINGS = 32
"""Maximum number of one writer's blocks that stay mapped."""


class Mapped:
    """The mapped blocks of one writer, which stay mapped, because mapping one costs as much as copying it. Thread-safe.

    Args:
        later: calls a function after some seconds.
    """

    def __init__(self, later: Callable[[float, Callable[[], None]], None]) -> None:
        self._later = later
        self._lock = Lock()
        self._blocks: dict[int, tuple[mmap.mmap, float]] = {}
        self._trims = False

    @property
    def size(self) -> int:
        """Number of mapped bytes."""
        with self._lock:
            return sum(len(memory) for memory, _ in self._blocks.values())

    def view(self, number: int, file: int, size: int) -> memoryview | bytes:
        """Return the message in a block, given the block's number and file, and the message's size.

        It is a copy if the block cannot be mapped. The caller closes the file, which is -1 if this process had no
        descriptor left. Raises `HubWireError` if the block does not have all of the message, and `OSError`, for
        example if a file is needed but missing.
        """
        with self._lock:
            memory, _ = self._blocks.pop(number, (None, 0.0))
        if memory is None or len(memory) < size:
            if file < 0:
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
            memory = _map(file, size)
        if memory is None:
            return _read(file, size)
        self._keep(number, memory)
        return memoryview(memory)[:size]

    def _keep(self, number: int, memory: mmap.mmap) -> None:
        outdated: list[mmap.mmap] = []  # unmapped without the lock, as that may take milliseconds
        with self._lock:
            self._blocks[number] = memory, time.monotonic()
            mapped = sum(len(other) for other, _ in self._blocks.values())
            while len(self._blocks) > 1 and (mapped > MAX_MAPPED or len(self._blocks) > MAX_MAPPINGS):
                oldest, _ = self._blocks.pop(next(iter(self._blocks)))
                outdated.append(oldest)
                mapped -= len(oldest)
            trims, self._trims = self._trims, True
        if not trims:
            self._later(IDLE_SECONDS, self._trim)

    def _trim(self) -> None:
        """Unmap the blocks that have not been used for some time, whose memory the writer may have returned."""
        with self._lock:
            due, before = time.monotonic() - IDLE_SECONDS, self._blocks
            self._blocks = {number: block for number, block in before.items() if block[1] > due}
            self._trims = again = bool(self._blocks)
        del before  # unmaps the others, without the lock
        if again:
            self._later(IDLE_SECONDS, self._trim)

    def close(self) -> None:
        """Unmap all blocks, as soon as no message is used. Safe to call twice."""
        with self._lock:
            before, self._blocks = self._blocks, {}
        before.clear()


def _map(file: int, size: int) -> mmap.mmap | None:
    """Map a block that has memory for all of a message and cannot shrink; None if that is impossible."""
    if not POSSIBLE:
        return None
    import fcntl  # which Windows lacks

    try:
        status = os.fstat(file)
        whole, memory = status.st_size, status.st_blocks * 512
        if min(whole, memory) < size or not fcntl.fcntl(file, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK:
            return None
        return mmap.mmap(file, whole, mmap.MAP_SHARED, mmap.PROT_READ)
    except (OSError, ValueError) as err:
        _log.debug("a block of a lane is copied: %s", err)
        return None


def _read(file: int, size: int) -> bytes:
    payload = os.pread(file, size, 0)
    if len(payload) < size:
        raise HubWireError(f"a block has {len(payload)} of the {size} bytes of a message")
    return payload


class LentPayload:
    """The payload of a message in a writer's block, which is given back when the last reference to this object ends.

    Attributes:
        view: the payload; invalid after the last reference to this object has ended.

    Args:
        give_back: called once, in any thread; it must not wait for a lock.
    """

    __slots__ = ("_give_back", "view")

    def __init__(self, view: memoryview, give_back: Callable[[], None]) -> None:
        self.view, self._give_back = view, give_back

    def __len__(self) -> int:
        return len(self.view)

    def to_bytes(self) -> bytes:
        """Return a copy of the payload."""
        return copied(self.view)

    def __del__(self) -> None:
        self._give_back()

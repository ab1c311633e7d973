"""Blocks, in which large messages travel on lanes: the writer's end.

A block is a file in memory (`memfd_create`) that the writer has mapped. The writer writes a message into it once, and
passes the file to each reader with a ``BLOCK`` record; the readers map it (`bridge.hub.lane.lent`) and give it back
with a ``FREE`` record, after which the writer uses it for another message. A block has all its memory before it is
written, and can never shrink, so no process can fail while it accesses memory that does not exist. Such files need no
room in ``/dev/shm``, and leave nothing behind when a process is killed.

Neither end populates a mapping, which takes milliseconds for a large block: Python's ``mmap`` would stop all threads
meanwhile. The pages appear when a message is written or read, which happens without the interpreter's lock.
"""

from __future__ import annotations

import itertools
import logging
import mmap
import os
import sys
import time
from collections.abc import Callable
from threading import Lock
from typing import Self

from bridge.messages.copies import copied, copy_to

_log = logging.getLogger(__name__)

POSSIBLE = sys.platform == "linux" and hasattr(os, "memfd_create")
"""Whether this Python has the calls; one that was built for an older system lacks them."""

MAX_BYTES = 128 << 20
"""Maximum total size in bytes of a session's blocks; a larger message has a block if no other block is in use."""

MAX_BLOCKS = 256
"""Maximum number of a session's blocks, each of which needs two descriptors (one is of the mapping)."""

_EXCESS, _SMALL = 4, 1 << 20
"""A message uses a block of at most this multiple of the message's size, or of at most this number of bytes."""

IDLE_SECONDS = 10.0
"""Seconds after which an unused block's memory is returned to the system."""


class Block:
    """A block of one session; the lock of its `Blocks` guards everything but ``file``.

    Attributes:
        number: identifies the block among those of the session.
        file: the descriptor of the file.
        size: number of bytes for which the file has memory, once `grow` has returned.
        users: number of loans to readers, plus one while a message is being sent.
        lost: a reader may still read the block although it will not give it back, so it is not used again.
        since: time since which nothing uses the block (monotonic seconds).
    """

    __slots__ = ("_memory", "file", "lost", "number", "since", "size", "users")

    def __init__(self, number: int, size: int) -> None:
        """Create an empty file, which will `grow` to ``size`` bytes; raises `OSError`."""
        import fcntl  # which Windows lacks

        self.number = number
        self.file = os.memfd_create("midspan-lane", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            fcntl.fcntl(self.file, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
        except OSError:
            os.close(self.file)
            raise
        self.size, self.users, self.lost, self.since = size, 1, False, 0.0
        self._memory: mmap.mmap | None = None

    def grow(self) -> None:
        """Let the file have memory for ``size`` bytes, and map it; raises `OSError`. Only for the only user."""
        if self._memory is None or len(self._memory) < self.size:
            os.posix_fallocate(self.file, 0, self.size)
            self._memory = mmap.mmap(self.file, self.size, mmap.MAP_SHARED)

    def view(self, size: int) -> memoryview:
        """Return the first bytes of the block, to read and write."""
        assert self._memory is not None
        return memoryview(self._memory)[:size]

    def close(self) -> None:
        """Close the file; the memory is returned when no process uses it."""
        self._memory = None
        os.close(self.file)


class Blocks:
    """The blocks of one session. Safe to use from any thread.

    The lock is held only for a moment, because a thread may also have the lock of a link, for which commands wait:
    returning the memory of a large block takes milliseconds.

    Args:
        later: calls a function after some seconds.
    """

    def __init__(self, later: Callable[[float, Callable[[], None]], None]) -> None:
        self._later = later
        self._lock = Lock()
        self._free: list[Block] = []
        self._numbers = itertools.count(1)
        self._size = self._count = 0
        self._trims = self._closed = False

    @property
    def size(self) -> int:
        """Total size of the blocks in bytes, including unused ones."""
        return self._size

    def store(self, payload: bytes) -> StoredMessage | None:
        """Return a message in a block, for the caller to `StoredMessage.release`; None without memory for one."""
        stored = StoredMessage(self)
        place = stored.room(len(payload))
        if place is None:
            return None
        copy_to(payload, place)
        return stored

    def reserve(self, size: int) -> Block | None:
        """Return a block with room for ``size`` bytes, for the caller to `release`; None without memory for it."""
        outdated: list[Block] = []
        with self._lock:
            block = self._pop_fitting(size)
            growth = max(0, size - (0 if block is None else block.size))
            while self._free and not self._has_room(growth, block):
                outdated.append(self._remove(self._free.pop()))
            possible = POSSIBLE and not self._closed and self._has_room(growth, block)
            if possible:
                self._size += growth
                self._count += block is None
            if possible and block is not None:
                block.size += growth
                block.users = 1
            elif block is not None:
                outdated.append(self._remove(block))
        for other in outdated:
            other.close()
        return self._grown(block, size) if possible else None

    def _grown(self, block: Block | None, size: int) -> Block | None:
        """Return a block, or a new one, after it has grown; None without memory for it."""
        try:
            if block is None:
                block = Block(next(self._numbers) & 0xFFFF_FFFF, size)
            block.grow()
        except OSError as err:
            _log.debug("a message of %d bytes is sent in parts: %s", size, err.strerror)
            if block is not None:
                self.release(block, lost=True)
                return None
            with self._lock:
                self._size -= size
                self._count -= 1
        return block

    def share(self, block: Block) -> None:
        """Add a user to a block."""
        with self._lock:
            block.users += 1

    def release(self, block: Block, *, lost: bool = False) -> None:
        """Remove a user from a block; ``lost`` if the user may still read it."""
        with self._lock:
            block.users -= 1
            block.lost = block.lost or lost
            if block.users:
                return
            outdated, trims = block.lost or self._closed, self._trims
            if outdated:
                self._remove(block)
            else:
                block.since = time.monotonic()
                self._free.append(block)
                self._trims = True
        if outdated:
            block.close()
        elif not trims:
            self._later(IDLE_SECONDS, self._trim)

    def close(self) -> None:
        """Return the memory of all blocks, as soon as nothing uses them. Safe to call twice."""
        with self._lock:
            self._closed = True
            unused, self._free = [self._remove(block) for block in self._free], []
        for block in unused:
            block.close()

    def _pop_fitting(self, size: int) -> Block | None:
        """Return a free block that may have to `grow` to its size; None if all would be too large."""
        fitting = [block for block in self._free if block.size <= max(_EXCESS * size, _SMALL)]
        # of equal ones the last used, which the processor's cache may still contain
        block = min(reversed(fitting), key=lambda block: (block.size < size, block.size), default=None)
        if block is not None:
            self._free.remove(block)
        return block

    def _has_room(self, growth: int, block: Block | None) -> bool:
        """Return whether a block, or a new one (None), may have a number of bytes more than now."""
        others = self._size - (0 if block is None else block.size)
        return (self._size + growth <= MAX_BYTES or not others) and (block is not None or self._count < MAX_BLOCKS)

    def _remove(self, block: Block) -> Block:
        """Count a block no longer; the caller closes it without the lock."""
        self._size -= block.size
        self._count -= 1
        return block

    def _trim(self) -> None:
        """Return the memory of blocks that nothing has used for some time."""
        with self._lock:
            due = time.monotonic() - IDLE_SECONDS
            idle = [block for block in self._free if block.since <= due]
            self._free = [block for block in self._free if block.since > due]
            for block in idle:
                self._remove(block)
            self._trims = again = bool(self._free)
        for block in idle:
            block.close()
        if again:
            self._later(IDLE_SECONDS, self._trim)


class StoredMessage:
    """A message that is written to a block of ``blocks``; its creator calls `release`.

    Attributes:
        block: the block; None until `room` has returned memory.
    """

    __slots__ = ("_blocks", "_size", "block")

    def __init__(self, blocks: Blocks) -> None:
        self._blocks, self._size = blocks, 0
        self.block: Block | None = None

    def __len__(self) -> int:
        return self._size

    def room(self, size: int) -> memoryview | None:
        """Return memory for a message of ``size`` bytes, None if no block is available. Call it only once."""
        self.block, self._size = self._blocks.reserve(size), size
        return None if self.block is None else self.block.view(size)

    def to_bytes(self) -> bytes:
        """Return a copy of the message."""
        assert self.block is not None
        return copied(self.block.view(self._size))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Stop using the block. Safe to call twice."""
        block, self.block = self.block, None
        if block is not None:
            self._blocks.release(block)

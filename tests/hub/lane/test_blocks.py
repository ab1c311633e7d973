"""Blocks hold large messages in memory that the readers of a lane share with the writer."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import mmap
import os
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from bridge.hub.lane import blocks as module
from bridge.hub.lane.blocks import IDLE_SECONDS, MAX_BLOCKS, MAX_BYTES, Blocks, StoredMessage

MB = 1 << 20


class Later:
    """Calls that are due at some time."""

    def __init__(self) -> None:
        self.calls: list[tuple[float, Callable[[], None]]] = []

    def __call__(self, seconds: float, call: Callable[[], None]) -> None:
        self.calls.append((seconds, call))

    def run(self) -> None:
        calls, self.calls = self.calls, []
        for _, call in calls:
            call()


@pytest.fixture
def later() -> Later:
    return Later()


@pytest.fixture
def blocks(later: Later) -> Iterator[Blocks]:
    pool = Blocks(later)
    yield pool
    pool.close()
    assert pool.size == 0, "a block was not released"


def stored(blocks: Blocks, payload: bytes) -> StoredMessage:
    message = blocks.store(payload)
    assert message is not None
    assert message.block is not None
    return message


def populated(file: int) -> int:
    """Return how many bytes of the mappings of a file in memory this process can access without a page fault."""
    found, lines = 0, iter(Path("/proc/self/smaps").read_text(encoding="utf-8").splitlines())
    inode = os.fstat(file).st_ino  # earlier tests may have left mappings of files with the same name
    for line in lines:
        if f" {inode} " in line and "/memfd:" in line:
            found += 1024 * int(next(entry for entry in lines if entry.startswith("Rss:")).split()[1])
    return found


def read(message: StoredMessage) -> bytes:
    """Read a message as a process would that has only the file."""
    assert message.block is not None
    return os.pread(message.block.file, len(message), 0)


def new_descriptors(before: Collection[int] = ()) -> list[int]:
    """Return the inode of each descriptor of a block, without the blocks in ``before``, which earlier tests created."""
    found = []
    for file in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # closed meanwhile
            if "midspan-lane" in str(file.readlink()):
                found.append(file.stat().st_ino)
    return [inode for inode in found if inode not in before]


def test_a_message_is_written_to_the_file() -> None:
    blocks = Blocks(lambda *_: None)
    message = stored(blocks, b"message")
    assert (len(message), message.to_bytes(), read(message)) == (7, b"message", b"message")
    with message:
        message.release()  # twice
    blocks.close()
    assert blocks.size == 0


def test_a_released_block_is_used_again(blocks: Blocks) -> None:
    first = stored(blocks, b"a" * MB)
    block = first.block
    first.release()
    second = stored(blocks, b"b" * 1000)
    assert second.block is block
    assert (read(second), blocks.size) == (b"b" * 1000, MB)
    second.release()


def test_the_last_used_of_equal_blocks_is_used(blocks: Blocks) -> None:
    """The processor's cache may still contain it."""
    held = [stored(blocks, bytes(MB)) for _ in range(3)]
    used = [message.block for message in held]
    for at in (0, 2, 1):
        held[at].release()
    message = stored(blocks, bytes(MB))
    assert message.block is used[1]
    message.release()


def test_a_block_is_not_used_again_while_a_reader_has_it(blocks: Blocks) -> None:
    first = stored(blocks, b"first")
    block = first.block
    assert block is not None
    blocks.share(block)
    first.release()
    second = stored(blocks, b"other")
    assert second.block is not block
    assert os.pread(block.file, 5, 0) == b"first"
    second.release()
    blocks.release(block)


def test_the_smallest_sufficient_block_is_used(blocks: Blocks) -> None:
    held = [stored(blocks, bytes(size)) for size in (4 * MB, MB, 2 * MB)]
    middle = held[2].block
    for message in held:
        message.release()
    message = stored(blocks, bytes(MB + 1))
    assert message.block is middle
    message.release()


def test_a_block_grows_for_a_larger_message(blocks: Blocks) -> None:
    stored(blocks, bytes(MB)).release()
    message = stored(blocks, b"x" * (3 * MB))
    assert (blocks.size, read(message), message.to_bytes()) == (3 * MB, b"x" * (3 * MB), b"x" * (3 * MB))
    message.release()


def test_a_block_has_its_memory_before_it_is_written_and_cannot_shrink(blocks: Blocks) -> None:
    """Without memory for a page, or beyond the file's end, an access would end the process with SIGBUS."""
    message = StoredMessage(blocks)
    assert message.room(3 * MB) is not None
    assert message.block is not None
    assert os.fstat(message.block.file).st_blocks * 512 >= 3 * MB
    with pytest.raises(PermissionError):
        os.ftruncate(message.block.file, 0)
    assert fcntl.fcntl(message.block.file, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK
    message.release()


def test_a_new_block_does_not_stop_other_threads(blocks: Blocks) -> None:
    """Python's mmap holds the interpreter's lock, for 20 ms if it populates a mapping of 64 MB."""
    message = StoredMessage(blocks)
    assert message.room(16 * MB) is not None
    assert message.block is not None
    assert populated(message.block.file) == 0
    message.release()


def test_the_number_of_descriptors_is_bounded(blocks: Blocks) -> None:
    before = new_descriptors()
    held = [stored(blocks, b"x") for _ in range(MAX_BLOCKS)]
    assert len(new_descriptors(before)) == 2 * MAX_BLOCKS
    assert blocks.store(b"x") is None
    held.pop().release()
    held.append(stored(blocks, bytes(2 * MB)))
    for message in held:
        message.release()


def test_a_block_of_another_size_replaces_an_unused_one_if_there_are_many(
    blocks: Blocks, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_BLOCKS", 2)
    large, other = stored(blocks, bytes(8 * MB)), stored(blocks, bytes(8 * MB))
    other.release()
    small = stored(blocks, b"x")
    assert blocks.size == 8 * MB + 1
    for message in (large, small):
        message.release()


def test_the_memory_is_bounded(blocks: Blocks) -> None:
    size = MAX_BYTES // 4
    held = [stored(blocks, bytes(size)) for _ in range(4)]
    assert blocks.store(bytes(MB)) is None
    held.pop().release()
    small = [stored(blocks, bytes(MB)), stored(blocks, bytes(MB))]
    assert blocks.size == MAX_BYTES - size + 2 * MB, "the larger block is not used up by a small message"
    for message in (*held, *small):
        message.release()


def test_unused_blocks_make_room_for_others(blocks: Blocks) -> None:
    for message in [stored(blocks, bytes(MB)) for _ in range(MAX_BYTES // MB)]:
        message.release()
    large = stored(blocks, bytes(MAX_BYTES // 2))
    assert blocks.size <= MAX_BYTES
    large.release()


def test_a_message_larger_than_all_blocks_has_one_if_no_other_is_in_use(blocks: Blocks) -> None:
    other = stored(blocks, bytes(MB))
    assert blocks.store(bytes(MAX_BYTES + 1)) is None
    other.release()
    large = stored(blocks, bytes(MAX_BYTES + 1))
    block = large.block
    assert blocks.store(bytes(MB)) is None
    large.release()
    again = stored(blocks, bytes(MAX_BYTES + 2))
    assert again.block is block
    again.release()


def test_a_block_that_a_lost_reader_may_still_read_is_not_used_again(blocks: Blocks) -> None:
    message = stored(blocks, b"lost")
    assert message.block is not None
    copy = os.dup(message.block.file)
    blocks.share(message.block)
    blocks.release(message.block, lost=True)
    message.release()
    assert blocks.size == 0
    stored(blocks, b"next").release()
    assert os.pread(copy, 4, 0) == b"lost"
    os.close(copy)


def test_idle_blocks_are_returned(blocks: Blocks, later: Later, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    stored(blocks, bytes(MB)).release()
    assert [seconds for seconds, _ in later.calls] == [IDLE_SECONDS]
    now += IDLE_SECONDS / 2
    stored(blocks, bytes(MB)).release()
    assert len(later.calls) == 1
    now += IDLE_SECONDS / 2
    later.run()
    assert blocks.size == MB, "it was used meanwhile"
    now += IDLE_SECONDS
    later.run()
    assert (blocks.size, later.calls) == (0, [])


def test_memory_is_returned_without_the_lock(blocks: Blocks, later: Later, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes 10 ms for 64 MB. A thread that waits for it may have the lock of a link, for which commands wait."""
    close, locked = module.Block.close, list[bool]()

    def record(block: module.Block) -> None:
        locked.append(blocks._lock.locked())
        close(block)

    monkeypatch.setattr(module.Block, "close", record)
    monkeypatch.setattr(module, "MAX_BYTES", 2 * MB)
    now = 1000.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    for message in [stored(blocks, bytes(MB)) for _ in range(2)]:
        message.release()
    message = stored(blocks, bytes(2 * MB))
    assert locked == [False], "another block makes room"
    message.release()
    now += IDLE_SECONDS
    later.run()
    assert locked == [False] * 2, "an idle block is returned"
    message = stored(blocks, b"lost")
    assert message.block is not None
    blocks.share(message.block)
    blocks.release(message.block, lost=True)
    message.release()
    assert locked == [False] * 3, "a reader was lost"
    stored(blocks, b"last").release()
    blocks.close()
    assert locked == [False] * 4, "the session ends"


def test_without_memory_or_descriptors_no_block_is_made(blocks: Blocks, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with monkeypatch.context() as patch:
        patch.setattr(os, "memfd_create", refuse)
        assert blocks.store(bytes(MB)) is None
    before = new_descriptors()
    for module_, call in ((fcntl, "fcntl"), (os, "posix_fallocate"), (mmap, "mmap")):
        with monkeypatch.context() as patch:
            patch.setattr(module_, call, refuse)
            assert blocks.store(bytes(MB)) is None
        assert (blocks.size, new_descriptors(before)) == (0, [])
    stored(blocks, bytes(MB)).release()
    blocks.close()
    assert new_descriptors(before) == []
    assert blocks.size == 0


def test_blocks_that_are_used_when_the_session_ends_are_returned_later(later: Later) -> None:
    blocks = Blocks(later)
    message = stored(blocks, bytes(MB))
    blocks.close()
    assert (blocks.size, blocks.store(bytes(MB))) == (MB, None)
    message.release()
    assert (blocks.size, later.calls) == (0, [])


def test_a_python_for_an_older_system_has_no_blocks(blocks: Blocks, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "POSSIBLE", False)
    monkeypatch.delattr(os, "memfd_create")
    assert blocks.store(bytes(MB)) is None

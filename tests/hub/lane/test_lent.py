"""A lane's reader maps the blocks of the writer, and gives a message back when it has been handled."""

from __future__ import annotations

import errno
import fcntl
import gc
import mmap
import os
import weakref
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest

from bridge.hub.errors import HubWireError
from bridge.hub.lane import lent as module
from bridge.hub.lane.blocks import IDLE_SECONDS
from bridge.hub.lane.lent import MAX_MAPPINGS, LentPayload, Mapped
from tests.hub.lane.test_blocks import Later, populated

KB = 1024


class Writer:
    """Makes blocks."""

    def __init__(self) -> None:
        self.files: list[int] = []

    def block(self, content: bytes, *, seals: int = fcntl.F_SEAL_SHRINK) -> int:
        file = os.memfd_create("test", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.write(file, content)
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, seals)
        self.files.append(file)
        return file


@pytest.fixture
def writer() -> Iterator[Writer]:
    writer = Writer()
    yield writer
    for file in writer.files:
        os.close(file)


@pytest.fixture
def later() -> Later:
    return Later()


@pytest.fixture
def mapped(later: Later) -> Iterator[Mapped]:
    mapped = Mapped(later)
    yield mapped
    mapped.close()
    assert mapped.size == 0


def test_a_block_is_mapped_once_and_shows_what_the_writer_writes(
    writer: Writer, mapped: Mapped, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = writer.block(b"first message")
    view = mapped.view(1, file, 5)
    assert isinstance(view, memoryview)
    assert (bytes(view), view.readonly) == (b"first", True)
    monkeypatch.setattr(mmap, "mmap", pytest.fail)
    os.pwrite(file, b"other", 0)
    again = mapped.view(1, -1, 8)  # this process has no descriptor left
    assert (bytes(again), mapped.size) == (b"other me", 13)


def test_a_new_mapping_does_not_stop_other_threads(writer: Writer, mapped: Mapped) -> None:
    """Python's mmap holds the interpreter's lock, for some milliseconds if it populates a large mapping."""
    file = writer.block(bytes(1000 * KB))
    view = mapped.view(1, file, 1000 * KB)
    assert (len(view), populated(file)) == (1000 * KB, 0)


def test_a_block_that_has_grown_is_mapped_again(writer: Writer, mapped: Mapped) -> None:
    file = writer.block(b"short")
    view = mapped.view(1, file, 5)
    os.pwrite(file, b"a longer message", 0)
    again = mapped.view(1, file, 16)
    assert (bytes(again), bytes(view), mapped.size) == (b"a longer message", b"a lon", 16)


def test_blocks_have_their_own_mappings(writer: Writer, mapped: Mapped) -> None:
    one, other = mapped.view(1, writer.block(b"one"), 3), mapped.view(2, writer.block(b"other"), 5)
    assert (bytes(one), bytes(other)) == (b"one", b"other")


def test_a_block_that_could_shrink_is_copied(writer: Writer, mapped: Mapped) -> None:
    """An access beyond the file's end would end the process."""
    file = writer.block(b"payload", seals=fcntl.F_SEAL_GROW)
    view = mapped.view(1, file, 7)
    os.ftruncate(file, 0)
    assert (view, mapped.size) == (b"payload", 0)


def test_a_block_that_may_have_no_memory_is_copied(writer: Writer, mapped: Mapped) -> None:
    """Without memory for a page, an access to a mapping would end the process with SIGBUS."""
    file = writer.block(b"")
    os.ftruncate(file, 1000 * KB)
    assert (mapped.view(1, file, 7), mapped.size) == (bytes(7), 0)


def test_without_memory_for_a_mapping_a_block_is_copied(
    writer: Writer, mapped: Mapped, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    monkeypatch.setattr(mmap, "mmap", refuse)
    assert mapped.view(1, writer.block(b"payload"), 7) == b"payload"


def test_a_block_without_all_of_a_message_is_an_error(writer: Writer, mapped: Mapped) -> None:
    with pytest.raises(HubWireError, match="5 of the 6 bytes"):
        mapped.view(1, writer.block(b"short"), 6)


def test_without_a_descriptor_an_unknown_block_is_an_error(writer: Writer, mapped: Mapped) -> None:
    with pytest.raises(OSError, match=os.strerror(errno.EMFILE)):
        mapped.view(1, -1, 5)
    mapped.view(1, writer.block(b"short"), 5)
    with pytest.raises(OSError, match=os.strerror(errno.EMFILE)):
        mapped.view(1, -1, 6)  # the block has grown


def is_mapped(mapped: Mapped, number: int) -> bool:
    try:
        mapped.view(number, -1, 1)
    except OSError:
        return False
    return True


@pytest.mark.parametrize("by_bytes", [True, False])
def test_the_mappings_are_bounded(
    writer: Writer, mapped: Mapped, monkeypatch: pytest.MonkeyPatch, *, by_bytes: bool
) -> None:
    monkeypatch.setattr(module, "MAX_MAPPED" if by_bytes else "MAX_MAPPINGS", 2 * KB if by_bytes else 2)
    files = [writer.block(bytes([number]) * KB) for number in range(4)]
    for number in (0, 1, 0, 2):
        mapped.view(number, files[number], KB)
    assert mapped.size == 2 * KB
    assert [is_mapped(mapped, number) for number in (0, 1, 2)] == [True, False, True]
    mapped.view(3, writer.block(bytes(5 * KB)), KB)
    assert mapped.size == (5 * KB if by_bytes else 6 * KB)


def test_a_view_outlives_its_mapping(writer: Writer, mapped: Mapped) -> None:
    views = [mapped.view(n, writer.block(bytes([n])), 1) for n in range(MAX_MAPPINGS + 1)]
    mapped.close()
    assert [bytes(view) for view in views] == [bytes([n]) for n in range(MAX_MAPPINGS + 1)]


def test_idle_blocks_are_unmapped(
    writer: Writer, mapped: Mapped, later: Later, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    mapped.view(1, writer.block(b"idle"), 4)
    mapped.view(2, writer.block(b"used"), 4)
    assert [seconds for seconds, _ in later.calls] == [IDLE_SECONDS]
    now += IDLE_SECONDS / 2
    mapped.view(2, -1, 4)
    now += IDLE_SECONDS / 2
    later.run()
    assert mapped.size == 4
    now += IDLE_SECONDS
    later.run()
    assert (mapped.size, later.calls) == (0, [])


def test_memory_is_unmapped_without_the_lock(
    writer: Writer, mapped: Mapped, later: Later, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It takes milliseconds for a large block, while the lane's thread may wait for the lock."""
    locked: list[bool] = []
    now = 1000.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    monkeypatch.setattr(module, "MAX_MAPPINGS", 1)
    for number in (1, 2):
        view = mapped.view(number, writer.block(b"payload"), 7)
        assert isinstance(view, memoryview)
        weakref.finalize(view.obj, lambda: locked.append(mapped._lock.locked()))
        del view
    assert locked == [False], "a newer block takes the place"
    now += 2 * IDLE_SECONDS
    later.run()
    assert locked == [False] * 2, "an idle block is unmapped"


def lent(content: bytes, give_back: Callable[[], None]) -> LentPayload:
    return LentPayload(memoryview(content), give_back)


def test_a_lent_payload_is_given_back_once_when_its_last_reference_ends() -> None:
    given_back: list[bool] = []
    payload = lent(b"payload", lambda: given_back.append(True))
    other = payload
    assert (len(payload), payload.to_bytes(), payload.to_bytes()) == (7, b"payload", b"payload")
    del payload
    assert given_back == []
    del other
    gc.collect()
    assert given_back == [True]

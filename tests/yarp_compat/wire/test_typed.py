"""Readers and writers of typed values, where no recorded bytes of real YARP exist."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import INT8, INT16, INT64, MAX_DEPTH


@pytest.mark.parametrize("word", ["abcde", "ö" * 5, "日本", 5])
def test_invalid_vocabs_are_refused(word: str) -> None:
    with pytest.raises(WireError, match="not a vocab"):
        ElementWriter(Profile.YARP3).vocab(word)


@pytest.mark.parametrize(
    "write",
    [
        lambda out: out.integer(2**32),
        lambda out: out.integer(-(2**31) - 1),
        lambda out: out.integer(256, INT8),
        lambda out: out.integer("1"),
        lambda out: out.float64("x"),
        lambda out: out.float64(None),
        lambda out: out.float32(1e300),
        lambda out: out.string(b"bytes"),
        lambda out: out.string("\ud800"),
        lambda out: out.raw(struct.Struct("<b"), 200),
    ],
)
def test_values_that_do_not_fit_are_refused_and_not_written(write: Callable[[ElementWriter], None]) -> None:
    out = ElementWriter(Profile.YARP4)
    with pytest.raises(WireError):
        write(out)
    assert out.payload() == b""


def test_unsigned_integers_keep_their_bits() -> None:
    out = ElementWriter(Profile.YARP3)
    out.integer(255, INT8, tagged=False)
    out.integer(2**16 - 1, INT16, tagged=False)
    out.integer(2**64 - 1, INT64, tagged=False)
    assert out.payload() == b"\xff" * 11


def test_large_blocks_are_not_copied_and_stay_in_order() -> None:
    large = bytearray(b"x" * 10_000)
    out = ElementWriter(Profile.YARP3)
    out.block(b"a")
    out.block(large)
    out.block(b"b")
    pieces = out.buffers()
    assert [len(piece) for piece in pieces] == [1, 10_000, 1]
    assert pieces[1] is large
    assert out.payload() == b"a" + bytes(large) + b"b"


def test_bytes_that_are_not_text_survive() -> None:
    out = ElementWriter(Profile.YARP3)
    out.string("a\udcffb")
    assert out.payload()[8:] == b"a\xffb"
    assert ElementReader(out.payload(), Profile.YARP3).string() == "a\udcffb"


def test_endlessly_nested_lists_are_refused() -> None:
    deep = b"\0\1\0\0\1\0\0\0" * 100_000
    source = ElementReader(deep, Profile.YARP3)
    for _ in range(MAX_DEPTH):
        source.begin()
    with pytest.raises(WireError, match=str(MAX_DEPTH)):
        source.begin()


def test_list_ends_after_its_announced_elements() -> None:
    source = ElementReader(bytes.fromhex("0101000002000000 01000000 02000000 03000000"), Profile.YARP3)
    assert source.begin() == 2
    assert (source.integer(), source.left) == (1, 1)
    with pytest.raises(WireError, match="1 elements too many"):
        source.end()
    assert source.integer() == 2
    with pytest.raises(WireError, match="one more element"):
        source.integer()
    source.end()
    assert source.pending == 4
    with pytest.raises(WireError, match="4 bytes after the end"):
        source.finish()


@pytest.mark.parametrize(
    "read",
    [
        ElementReader.begin,
        ElementReader.integer,
        ElementReader.float64,
        ElementReader.boolean,
        ElementReader.word,
        ElementReader.blob,
        ElementReader.next_tag,
    ],
)
def test_incomplete_and_invalid_bytes_are_distinguished(read: Callable[[ElementReader], object]) -> None:
    with pytest.raises(Incomplete):
        read(ElementReader(b"\4\0", Profile.YARP3))
    if read is not ElementReader.next_tag:
        with pytest.raises(WireError) as caught:
            read(ElementReader(b"\x0b\0\0\0" + bytes(20), Profile.YARP3))
        assert caught.type is WireError


@pytest.mark.parametrize("size", [-1, 2**31 - 1])
@pytest.mark.parametrize("tag", [4, 12])
def test_lengths_are_checked_before_memory_is_allocated(tag: int, size: int) -> None:
    data = struct.pack("<ii", tag, size) + b"x"
    with pytest.raises(WireError):
        ElementReader(data, Profile.YARP3).string() if tag == 4 else ElementReader(data, Profile.YARP3).blob()

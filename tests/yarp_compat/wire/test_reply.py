"""Detection of the end of a reply, and of a Bottle's profile."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.yarp_compat.wire.content import bottles, strings
from yarp_compat.wire.binary import encode
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reply import ReplyReader, plain_end, recognize
from yarp_compat.wire.values import Float32, Vocab

ACK = bytes.fromhex("5941000000005250")
ordinary = st.integers(-1000, 1000).map(lambda number: number / 8)
"""Floats whose bytes do not resemble tags."""
floats = st.lists(ordinary | ordinary.map(Float32) | st.integers(100, 10**6) | strings, max_size=5)


@pytest.mark.parametrize("profile", Profile)
@given(values=bottles, step=st.integers(1, 40))
def test_end_is_found_in_pieces(profile: Profile, values: list[Any], step: int) -> None:
    wire = encode(values, profile)
    reader = ReplyReader(profile)
    for end in range(0, len(wire), step):
        with pytest.raises(Incomplete):
            reader.end(wire[:end])
    assert reader.end(wire + ACK) == len(wire)
    assert reader.end(wire + ACK) == len(wire)
    assert plain_end(wire, profile) in (0, len(wire))


@pytest.mark.parametrize("profile", Profile)
@given(values=floats | st.lists(floats, max_size=3))
@example(values=[[Float32(0.0)], ["000000000"]])
def test_profile_is_detected_from_an_acknowledged_reply(profile: Profile, values: list[Any]) -> None:
    wire = encode(values, profile)
    reader = ReplyReader()
    whole = wire + ACK
    for end in range(len(wire)):
        with pytest.raises(Incomplete):
            reader.end(whole[:end])
    assert reader.end(whole) == len(wire)
    assert recognize(wire) in (profile, None)
    assert reader.profile in (recognize(wire), profile)


@pytest.mark.parametrize("profile", Profile)
def test_profile_is_detected_from_its_own_tags(profile: Profile) -> None:
    for values in ([1.5], [Float32(1.5)], [[1, [2.5, "x"]]], [{"a": 1.5}], [Float32(1.5), "text", 7]):
        assert recognize(encode(values, profile)) is profile
    for values in ([], [1, "a", b"b", [Vocab("set"), True]], [{"a": 1}]):
        assert recognize(encode(values, profile)) is None
    assert recognize(encode([Vocab("setmap")], Profile.YARP4)) is Profile.YARP4


@pytest.mark.parametrize("values", [[0.5] * 3, [0.5, "x", 3], [Float32(0.5)] * 3, [Float32(0.5), "x"], [1, 2]])
def test_profile_is_detected_without_an_acknowledgment(values: list[Any]) -> None:
    wire = encode(values, Profile.YARP3)
    reader = ReplyReader(acked=False)
    assert reader.end(wire) == len(wire)
    if 0.5 in values:
        assert reader.profile is Profile.YARP3


def test_acknowledgment_decides_the_profile() -> None:
    """Two numbers of four bytes, or one of eight: the bytes after them decide."""
    wire = encode([Float32(0.5)] * 2, Profile.YARP4)
    reader = ReplyReader()
    for end in (len(wire), len(wire) + 7):
        with pytest.raises(Incomplete):
            reader.end((wire + ACK)[:end])
    assert reader.end(wire + ACK) == len(wire)
    assert reader.profile is Profile.YARP4


def test_missing_acknowledgment_is_an_error() -> None:
    wire = encode([Float32(0.5)] * 2, Profile.YARP4)
    with pytest.raises(WireError, match="no acknowledgment follows"):
        ReplyReader().end(wire + b"x" * 16)


def test_each_byte_is_read_once() -> None:
    class Counted(bytes):
        seen = 0

        def __getitem__(self, key: Any) -> Any:
            raise AssertionError("no slices needed")

    wire = Counted(encode([[1.5] * 50, "x", {"a": [1, "b"]}] * 1000, Profile.YARP3))
    reader = ReplyReader(Profile.YARP3)
    view = memoryview(wire)
    steps = []
    for end in range(0, len(wire), 1000):
        with pytest.raises(Incomplete):
            reader.end(view[:end])
        (walk,) = reader._walks.values()
        steps.append(walk._at)
    assert steps == sorted(steps)
    assert steps[-1] > len(wire) - 2000
    assert reader.end(view) == len(wire)


@pytest.mark.parametrize(
    ("wire", "reason"),
    [
        (struct.pack("<ii", 1, 0), "not the tag of a list"),
        (struct.pack("<ii", 256, -1), "has -1 elements"),
        (struct.pack("<ii", 256, 2**31 - 1), "beyond the limit"),
        (struct.pack("<ii", 257, 300), "beyond the limit"),
        (struct.pack("<ii", 261, 3), "unknown type"),
        (struct.pack("<iiii", 256, 1, 4, 2000), "longer than the limit"),
        (struct.pack("<iiii", 256, 1, 4, -5), "length of -5"),
        (struct.pack("<iii", 260, 1, -5), "length of -5"),
        (struct.pack("<iiii", 256, 1, 77, 0), "77 at byte 8"),
        (struct.pack("<iiiii", 256, 1, 0x300, 1, 0), "not the tag of a list"),
        (struct.pack("<ii", 256, 1) * 130, "nested deeper"),
    ],
)
def test_invalid_replies_are_refused(wire: bytes, reason: str) -> None:
    for reader in (ReplyReader(Profile.YARP3, limit=1040), ReplyReader(limit=1040)):
        with pytest.raises(WireError, match=reason) as raised:
            reader.end(wire)
        assert type(raised.value) is WireError
    with pytest.raises(WireError):
        recognize(wire)


def test_bottles_of_the_wrong_length_are_not_recognized() -> None:
    wire = encode([1, 2], Profile.YARP3)
    for wrong in (wire[:-1], wire + b"x", b""):
        with pytest.raises(WireError):
            recognize(wrong)

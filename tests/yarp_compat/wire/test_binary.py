"""Bottles as bytes, in both profiles."""

from __future__ import annotations

import array
import enum
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from tests.yarp_compat.portables import PORTABLES
from tests.yarp_compat.wire.content import bottles, typed
from yarp_compat.wire import tags
from yarp_compat.wire.binary import decode, decode_arrays, decode_prefix, encode, encode_parts
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Float32, Group, Int8, Int16, Int64, Vocab, Vocab64

SPECIAL = [1e300, 1 / 3, float("nan"), float("inf"), float("-inf")]
MEASURED: dict[str, list[Any]] = {
    "empty": [],
    "int8 5": [Int8(5)],
    "int16 5": [Int16(5)],
    "int32 -2": [-2],
    "int64 5": [Int64(5)],
    "float32 1.5": [Float32(1.5)],
    "float64 .1": [0.1],
    "float64 3": [3.0],
    "float specials": SPECIAL,
    "string": ["hi"],
    "vocab32 set": [Vocab("set")],
    "vocab64 setmap": [Vocab("setmap")],
    "bools": [True, False],
    "blob": [b"\x01\x02\xff"],
    "(empty list)": [[]],
    "((1 2))": [[1, 2]],
    "((1) (2))": [[1], [2]],
    "((1) (a))": [[1], ["a"]],
    "((1) (2 a))": [[1], [2, "a"]],
    "dict{x:1,y:z}": [{"x": 1, "y": "z"}],
    "7 dict{x:1}": [7, {"x": 1}],
    "quoting": ["a b", "", "true", "12", 'a"b\\c\nd\te', "x-1.y_z", "/port", "é", "[v]"],
}
"""The values whose bytes a real YARP 4.0 wrote (`data/portables.txt`)."""

FLOATS = {b"\x0a\x01": b"\x80\x01", b"\x14\x01": b"\x0a\x01"}
"""The tags of lists of floats of YARP 4, and those of YARP 3."""


def data(text: str) -> bytes:
    return bytes.fromhex(text)


@pytest.mark.parametrize("name", MEASURED)
def test_values_have_the_bytes_of_real_yarp(name: str) -> None:
    values, wire = MEASURED[name], PORTABLES[f"Bottle {name}"]
    assert encode(values, Profile.YARP4) == wire
    assert typed(decode(wire, Profile.YARP4)) == typed(values)
    assert typed(decode(wire)) == typed(values)
    if name != "vocab64 setmap":
        older = FLOATS.get(wire[:2], wire[:2]) + wire[2:]
        assert encode(values, Profile.YARP3) == older
        assert typed(decode(older, Profile.YARP3)) == typed(values)


def test_property_and_stamp_have_the_bytes_of_real_yarp() -> None:
    stamp = [5, 123.5]
    assert encode(stamp, Profile.YARP4) == PORTABLES["Stamp"]
    assert encode(stamp, Profile.YARP3) == PORTABLES["Stamp"].replace(b"\x14\0\0\0", b"\x0a\0\0\0")
    assert decode(PORTABLES["Property"]) == [["GRP", ["z", 1]], ["device", "x"], ["f", 0.5], ["n", 3]]


@pytest.mark.parametrize("profile", Profile)
@given(values=bottles)
def test_all_values_survive_encoding(profile: Profile, values: list[Any]) -> None:
    if profile is Profile.YARP3:
        values = _without_long_vocabs(values)
    wire = encode(values, profile)
    back = decode(wire, profile)
    assert typed(back) == typed(values)
    assert encode(back, profile) == wire
    assert b"".join(bytes(part) for part in encode_parts(values, profile)) == wire
    assert decode_prefix(wire + b"more", profile) == (back, len(wire)) or "nan" in str(back)
    assert typed(decode_prefix(b"xyz" + wire, profile, 3)[0]) == typed(values)
    assert typed(_listed(decode_arrays(wire, profile))) == typed(values)


@pytest.mark.parametrize("profile", Profile)
@given(values=bottles)
def test_truncated_bottle_is_incomplete(profile: Profile, values: list[Any]) -> None:
    wire = encode(values, profile)
    for end in {0, 1, 7, 8, 12, len(wire) // 2, len(wire) - 1} - {len(wire)}:
        with pytest.raises(Incomplete):
            decode_prefix(wire[: min(end, len(wire) - 1)], profile)
    with pytest.raises(WireError, match="2 bytes follow"):
        decode(wire + b"ab", profile)


def test_lists_of_one_type_may_have_tags() -> None:
    wire = data("0001000002000000 0100000001000000 0100000002000000")
    assert decode(wire) == [1, 2]
    nested = data("0001000001000000 0001000001000000 0a000000 0000000000000840")
    assert decode(nested, Profile.YARP3) == [[3.0]]


def test_small_int_can_end_a_mixed_list() -> None:
    for values in ([1, Int8(-2)], ["a", Int16(-300)], [Int8(1), Int16(2)]):
        assert typed(decode(encode(values, Profile.YARP3))) == typed(values)


def test_ints_have_32_bits_or_64_if_needed() -> None:
    assert encode([2**31 - 1, -(2**31)], Profile.YARP3)[:4] == data("01010000")
    assert encode([2**31, -(2**31) - 1], Profile.YARP3)[:4] == data("11010000")
    assert encode([1, 2**31], Profile.YARP3) == data("0001000002000000 0100000001000000 110000000000008000000000")
    assert encode([Int64(1), 2**31], Profile.YARP3)[:4] == data("11010000")


def test_dicts_are_sorted_and_may_contain_groups() -> None:
    grouped = {"n": 1, "G": ({"b": 2}, 3), "E": (), "A": Group(y=2, x=1)}
    (decoded,) = decode(encode([grouped], Profile.YARP3))
    assert list(decoded) == ["A", "E", "G", "n"]
    assert decoded == {"A": (["x", 1], ["y", 2]), "E": (), "G": ({"b": 2}, 3), "n": 1}


def test_entries_of_a_dict_that_are_not_lists_are_ignored() -> None:
    wire = data("0001000001000000 00030000") + encode([5, [], [7, "x"], ["k", 1], ["k", 2]], Profile.YARP3)
    assert decode(wire) == [{"": (), "7": "x", "k": 2}]
    assert decode(encode(decode(wire), Profile.YARP3)) == decode(wire)
    assert encode(decode(wire), Profile.YARP3) == data("0001000001000000 00030000") + encode(
        [[], [7, "x"], ["k", 2]], Profile.YARP3
    )


@pytest.mark.parametrize("profile", Profile)
@pytest.mark.parametrize(
    ("kind", "python"),
    [("f8", float), ("f4", Float32), ("i1", Int8), ("i2", Int16), ("i4", int), ("i8", Int64)],
)
def test_arrays_are_lists_of_their_type(profile: Profile, kind: str, python: type) -> None:
    numbers = np.array([1, -2, 3], kind)
    wire = encode(numbers, profile)  # type: ignore[arg-type]
    assert wire == encode([python(number) for number in numbers], profile)
    assert encode([numbers, "x"], profile) == encode([[python(number) for number in numbers], "x"], profile)
    assert encode(np.array([1, 9, -2, 9, 3, 9], kind)[::2], profile) == wire  # type: ignore[arg-type]
    assert encode(numbers.astype(numbers.dtype.newbyteorder(">")), profile) == wire  # type: ignore[arg-type]
    back = decode_arrays(wire, profile)
    assert back.dtype == np.dtype(kind)
    assert back.tolist() == [1, -2, 3]
    assert np.shares_memory(back, np.frombuffer(wire, np.uint8))
    assert encode([numbers[0]], profile) == encode([python(1)], profile)


def test_arrays_of_other_types_and_shapes_are_encoded_like_lists() -> None:
    assert encode([np.eye(2)], Profile.YARP3) == encode([[[1.0, 0.0], [0.0, 1.0]]], Profile.YARP3)
    assert encode([np.array([200, 1], np.uint8)], Profile.YARP3) == encode([[Int8(-56), Int8(1)]], Profile.YARP3)
    assert encode([np.array([1.5], np.float16)], Profile.YARP3) == encode([[Float32(1.5)]], Profile.YARP3)
    assert encode([np.array([True, False])], Profile.YARP3) == encode([[True, False]], Profile.YARP3)
    assert encode([np.array(["a", "b"])], Profile.YARP3) == encode([["a", "b"]], Profile.YARP3)
    assert encode([np.array([], float)], Profile.YARP3) == encode([[]], Profile.YARP3)
    assert encode([np.array(7.0)], Profile.YARP3) == encode([7.0], Profile.YARP3)
    assert encode([np.bool_(True), np.str_("x")], Profile.YARP3) == encode([True, "x"], Profile.YARP3)


def test_large_arrays_and_blobs_are_not_copied() -> None:
    numbers, blob = np.zeros(1000), bytes(5000)
    parts = encode_parts([numbers, blob], Profile.YARP3)
    assert any(np.shares_memory(np.frombuffer(part, np.uint8), numbers) for part in parts)
    assert any(part is blob for part in parts)


def test_subclasses_are_written_as_their_base() -> None:
    class Name(str):
        __slots__ = ()

    odd: list[Any] = [enum.IntEnum("E", "A").A, Name("n"), bytearray(b"b"), memoryview(b"m"), array.array("d", [1.5])]  # type: ignore[attr-defined]
    assert encode([*odd, range(2)], Profile.YARP3) == encode([1, "n", b"b", b"m", [1.5], [0, 1]], Profile.YARP3)


def test_vocabs_of_yarp_3_have_four_letters() -> None:
    assert encode([Vocab("setmap")], Profile.YARP3) == encode([Vocab("setm")], Profile.YARP3)
    assert encode([Vocab64("set")], Profile.YARP3) == encode([Vocab("set")], Profile.YARP3)
    assert encode([Vocab64("set")], Profile.YARP4)[:4] == data("12010000")
    assert decode(encode([Vocab("1"), Vocab("")], Profile.YARP3)) == [True, False]


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (None, "cannot contain None, which is a NoneType"),
        (object, "cannot contain"),
        ({1: 2}, "key 1 of a dict is not a str"),
        (2**63, "too large"),
        (Int8(200), "too large"),
        (Float32(1e300), "too large"),
        (1j, "cannot contain"),
        ("\ud800", "cannot encode"),
        (Vocab("ninebytes"), "longer than 8 bytes"),
        (np.array([1j]), "cannot contain"),
        ({1, 2}, "cannot contain"),
    ],
)
def test_unsupported_values_are_refused(value: Any, reason: str) -> None:
    for values in ([value], [value, "x"], [[value]], [value, value]):
        with pytest.raises(WireError, match=reason):
            encode(values, Profile.YARP4)


@pytest.mark.parametrize(
    ("wire", "reason"),
    [
        ("", "needs 8 bytes, but 0 are left"),
        ("0100000000000000", "not the tag of a list"),
        ("0003000000000000", "not the tag of a list"),
        ("00010000ffffffff", "has -1 elements"),
        ("00010000ffffff7f", "needs at least"),
        ("0a010000ffffff7f", "needs"),
        ("04010000ffffff7f", "needs at least"),
        ("0501000001000000 00000000", "5 in a list's tag"),
        ("0001000001000000 05000000 00000000", "unknown tag 5 at byte 8"),
        ("0001000001000000 04000000 ffffffff", "length of -1"),
        ("0401000001000000 ffffffff", "length of -1"),
        ("0001000001000000 0c000000 05000000 00", "incomplete"),
        ("0001000001000000 20000000", "needs at least"),
        ("0001000001000000 40000000 00", "incomplete"),
        ("0001000002000000 0100000001000000 0100", "missing|needs at least|incomplete"),
        ("0001000001000000 0a000000 00000000", "12 bytes"),
        ("0001000001000000 11000000 00000000", "12 bytes"),
        ("0001000001000000 00030000 05000000 00000000", "not the tag of a list"),
        ("0104000001000000 00000000", "not the tag of a list"),
    ],
)
def test_invalid_bottles_are_refused(wire: str, reason: str) -> None:
    with pytest.raises(WireError, match=reason):
        decode(data(wire), Profile.YARP3)


def test_announced_sizes_reserve_no_memory() -> None:
    for tag in (0, *tags.sizes(Profile.YARP3), tags.STRING):
        with pytest.raises(WireError):
            decode(struct.pack("<ii", 256 | tag, 2**31 - 1) + bytes(100), Profile.YARP3)


def test_nesting_of_lists_is_limited() -> None:
    values: list[Any] = []
    for _ in range(tags.MAX_DEPTH):
        values = [values]
    assert decode(encode(values, Profile.YARP3)) == values
    with pytest.raises(WireError, match="nested deeper"):
        encode([values], Profile.YARP3)
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(WireError, match="nested deeper"):
        encode(endless, Profile.YARP3)
    with pytest.raises(WireError, match="nested deeper"):
        decode(struct.pack("<ii", 256, 1) * 1_000_000)
    with pytest.raises(WireError, match="nested deeper"):
        decode(struct.pack("<ii", 256, 1) + struct.pack("<iii", 0x300, 256, 1) * 1_000_000)


def test_any_kind_of_buffer_is_read() -> None:
    wire = encode(["a", b"b", [1.5, 2.5], Int8(1)], Profile.YARP3)
    for kind in (bytearray, memoryview):
        back = decode(kind(wire))
        assert typed(back) == typed(["a", b"b", [1.5, 2.5], Int8(1)])
        assert type(back[1]) is bytes
    writable = bytearray(encode(np.zeros(3), Profile.YARP3))  # type: ignore[arg-type]
    decode_arrays(writable)[1] = 5.0
    assert decode(writable) == [0.0, 5.0, 0.0]


def _without_long_vocabs(values: Any) -> Any:
    if isinstance(values, (list, tuple)):
        return type(values)([_without_long_vocabs(value) for value in values])
    if isinstance(values, dict):
        return {key: _without_long_vocabs(value) for key, value in values.items()}
    return Vocab(values[:4].lstrip("1") or "a") if isinstance(values, Vocab) else values


def _listed(values: Any) -> Any:
    """Convert arrays to lists."""
    if isinstance(values, np.ndarray):
        return decode(encode(values, Profile.YARP4), Profile.YARP4)  # type: ignore[arg-type]
    if isinstance(values, (list, tuple)):
        return type(values)([_listed(value) for value in values])
    return {key: _listed(value) for key, value in values.items()} if isinstance(values, dict) else values

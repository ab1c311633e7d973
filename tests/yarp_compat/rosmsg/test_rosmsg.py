"""ROS messages without ROS: definitions, classes, and the encoding of YARP 3.5's generated classes."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yarp_compat.os.ports.nested import NestedName
from yarp_compat.rosmsg.definition import DefinitionError, MessageField, full_name, parse
from yarp_compat.rosmsg.library import MessageLibrary
from yarp_compat.rosmsg.message import TickTime
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile

LINE = "=" * 80
SCAN = f"""
# a laser
std_msgs/Header header
float32 angle_min       # rad
float32[] ranges
uint8[] flags
string[2] names
Point[] points
int8 LEFT=-1
string GREETING = hello # there
bool ok
duration age
uint32 count 7
{LINE}
MSG: test/Point
float64 x
int64 id
"""


@pytest.fixture
def library() -> MessageLibrary:
    library_ = MessageLibrary({})
    library_.add("test/Scan", SCAN)
    return library_


def test_a_definition_is_parsed() -> None:
    definitions = parse(SCAN, "test/msg/Scan")
    scan = definitions["test/Scan"]
    assert scan.fields[:5] == (
        MessageField("header", "std_msgs/Header"),
        MessageField("angle_min", "float32"),
        MessageField("ranges", "float32", True),
        MessageField("flags", "uint8", True),
        MessageField("names", "string", True, 2),
    )
    assert scan.constants == {"LEFT": -1, "GREETING": "hello # there"}
    assert scan.fields[-1] == MessageField("count", "uint32")
    assert [field.type for field in definitions["test/Point"].fields] == ["float64", "int64"]


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("string<=10 text", MessageField("text", "string")),
        ("int32[<=5] few", MessageField("few", "int32", True)),
        ("builtin_interfaces/Time stamp", MessageField("stamp", "time")),
        ("geometry_msgs/msg/Pose pose", MessageField("pose", "geometry_msgs/Pose")),
        ("Header header", MessageField("header", "std_msgs/Header")),
        ("Other other", MessageField("other", "pkg/Other")),
        ('string name "with = sign"', MessageField("name", "string")),
    ],
)
def test_spellings_of_ros1_and_ros2_are_parsed(line: str, field: MessageField) -> None:
    assert parse(line, "pkg/Name")["pkg/Name"].fields == (field,)


@pytest.mark.parametrize(
    "text",
    [
        "int32",
        "int32 9x",
        "int32 a\nint32 a",
        "a/b/c/d x",
        "float[x] y",
        "int32[99999999999] y",
        "time T=3",
        "bool B=maybe",
    ],
)
def test_an_error_names_the_type(text: str) -> None:
    with pytest.raises(DefinitionError, match="pkg/Name"):
        parse(text, "pkg/Name")


def test_type_names_are_normalized() -> None:
    assert full_name("std_msgs/msg/String") == full_name("std_msgs/String") == "std_msgs/String"
    with pytest.raises(DefinitionError, match="package/Name"):
        full_name("String")


@pytest.mark.parametrize("profile", Profile)
def test_the_encoding_equals_that_of_the_classes_of_yarp(library: MessageLibrary, profile: Profile) -> None:
    message: Any = library.get("test/Scan")(
        angle_min=0.5,
        ranges=[1.0, 2.0],
        flags=b"\x01\xff",
        names=["a", "é"],
        ok=True,
        age=TickTime(-2, 5),
        count=2**32 - 1,
    )
    message.header.seq, message.header.stamp, message.header.frame_id = 3, TickTime(4, 6), "laser"
    message.points = [library.get("test/Point")(x=1.5, id=-1)]
    f32, f64 = profile.float32_tag, profile.float64_tag
    expected = (
        struct.pack("<ii", 256, 9)
        + struct.pack("<ii ii ii ii ii ii", 256, 3, 1, 3, 256, 2, 1, 4, 1, 6, 4, 5) + b"laser"
        + struct.pack("<if", f32, 0.5)
        + struct.pack("<ii ff", 256 | f32, 2, 1.0, 2.0)
        + struct.pack("<ii", 256 | 32, 2) + b"\x01\xff"
        + struct.pack("<iii", 256 | 4, 2, 1) + b"a" + struct.pack("<i", 2) + "é".encode()
        + struct.pack("<ii ii id iq", 256, 1, 256, 2, f64, 1.5, 17, -1)
        + struct.pack("<ib", 32, 1)
        + struct.pack("<ii ii ii", 256, 2, 1, -2, 1, 5)
        + struct.pack("<ii", 1, -1)
    )  # fmt: skip
    assert message.to_bytes(profile) == expected
    decoded: Any = library.get("test/Scan").from_bytes(expected, profile)
    assert decoded == message
    assert decoded.count == 2**32 - 1
    assert decoded.flags == [1, 255]
    assert library.get("test/Scan").from_bytes(expected) == message


def test_empty_arrays_keep_their_type(library: MessageLibrary) -> None:
    library.add("test/Empty", "float64[] a\nstring[] b\nPoint[] c\nuint8[] d")
    data = library.get("test/Empty")().to_bytes()
    assert data == struct.pack("<ii ii ii ii ii", 256, 4, 256 | 10, 0, 256 | 4, 0, 256, 0, 256 | 32, 0)


def test_text_and_loose_bottles_are_read(library: MessageLibrary) -> None:
    Point = library.get("test/Point")
    point = Point()
    point.from_text("3 4")
    assert point == Point(x=3.0, id=4)
    assert Point(x=0.5, id=2).to_text() == "0.5 2"
    library.add("test/Numbers", "float64[] a\nint16[] b\nbool[] c\ntime t")
    loose: Any = library.get("test/Numbers").from_bytes(binary.encode([[1, 2], [3, 4], [1, 0], 1.5], Profile.YARP3))
    assert (loose.a, loose.b, loose.c, loose.t) == ([1.0, 2.0], [3, 4], [True, False], TickTime(1, 500_000_000))


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ([1], "2 fields, but 1 were received"),
        (["x", 1], r"test/Point.x must be float64"),
        ([1.0, [2]], r"test/Point.id must be int64"),
    ],
)
def test_messages_of_another_type_are_rejected(library: MessageLibrary, values: list[object], problem: str) -> None:
    with pytest.raises(WireError, match=problem):
        library.get("test/Point").from_bytes(binary.encode(values, Profile.YARP3))


def test_an_error_names_the_field(library: MessageLibrary) -> None:
    Scan, Point = library.get("test/Scan"), library.get("test/Point")
    with pytest.raises(WireError, match=r"test/Scan.ranges must be float32\[\]"):
        Scan(ranges=["a"]).to_bytes()
    with pytest.raises(WireError, match=r"test/Scan.names must be string\[\]"):
        Scan(names=["only one"]).to_bytes()
    with pytest.raises(WireError, match=r"test/Point.x must be float64"):
        Scan(points=[Point(x="far")]).to_bytes()
    with pytest.raises(WireError, match=r"count must be uint32"):
        Scan(count=-(2**40)).to_bytes()
    with pytest.raises(AttributeError, match=r"no field 'rangs'"):
        Scan().rangs = [1.0]


def test_numpy_arrays_are_written(library: MessageLibrary) -> None:
    Scan = library.get("test/Scan")
    assert Scan(ranges=np.arange(3.0)).to_bytes() == Scan(ranges=[0.0, 1.0, 2.0]).to_bytes()
    assert Scan(flags=np.array([1, 2], np.uint8)).to_bytes() == Scan(flags=[1, 2]).to_bytes()


def test_files_are_found_on_first_use(tmp_path: Path) -> None:
    (tmp_path / "a" / "pkg" / "msg").mkdir(parents=True)
    (tmp_path / "a" / "pkg" / "msg" / "One.msg").write_text("Two two\n")
    (tmp_path / "share" / "pkg" / "msg").mkdir(parents=True)
    (tmp_path / "share" / "pkg" / "msg" / "Two.msg").write_text("int32 n\n")
    library = MessageLibrary({"YARP_ROSMSG_PATH": str(tmp_path / "a"), "AMENT_PREFIX_PATH": str(tmp_path)})
    message: Any = library.get("pkg/One")()
    assert message.two.n == 0
    assert library.get("pkg/One") is library.get("pkg/msg/One")


def test_ask_is_called_only_without_a_file() -> None:
    library = MessageLibrary({})
    calls = []
    library.ask = lambda name: (
        calls.append(name) or (f"Two two\n{LINE}\nMSG: pkg/Two\nint32 n" if name == "pkg/One" else None)
    )
    message: Any = library.get("pkg/One")()
    assert message.two.n == 0
    assert calls == ["pkg/One"]
    with pytest.raises(DefinitionError, match="YARP_ROSMSG_PATH"):
        library.get("pkg/Three")


def test_recursive_types_are_rejected() -> None:
    library = MessageLibrary({})
    library.add("p/A", "B b")
    library.add("p/B", "A[] a")
    with pytest.raises(DefinitionError, match="contains itself"):
        library.get("p/A")


@pytest.mark.parametrize("name", ["../etc/passwd", "a/../b", "/x/y", "a/b.c", "a"])
def test_invalid_names_are_not_used_as_paths(name: str, tmp_path: Path) -> None:
    with pytest.raises(DefinitionError):
        MessageLibrary({"YARP_ROSMSG_PATH": str(tmp_path)}).get(name)


_LIBRARY = MessageLibrary({})
_LIBRARY.add("test/Scan", SCAN)
_SCAN = _LIBRARY.get("test/Scan")(ranges=[1.0, 2.0], names=["a", "b"], points=[_LIBRARY.get("test/Point")()])


@given(st.binary(max_size=200), st.integers(0, 300), st.sampled_from([None, *Profile]))
def test_malicious_bytes_are_rejected_or_decoded(junk: bytes, at: int, profile: Profile | None) -> None:
    data = _SCAN.to_bytes()
    for payload in (junk, data[:at] + junk, data[:at] + junk + data[at + len(junk) :]):
        with contextlib.suppress(WireError):
            assert _LIBRARY.get("test/Scan").from_bytes(payload, profile).to_bytes()


@given(
    st.text(st.sampled_from("ab1 _/[]<=#\n\"'-:."), max_size=60),
    st.sampled_from(["", "int32 a\n", f"{LINE}\nMSG: a/b\n"]),
)
def test_malicious_definitions_are_rejected_or_parsed(junk: str, before: str) -> None:
    library = MessageLibrary({})
    with contextlib.suppress(DefinitionError):
        library.add("test/Type", before + junk)
        kind = library.get("test/Type")
        assert kind() == kind.from_bytes(kind().to_bytes())


@given(st.text(max_size=40))
def test_any_nested_name_is_parsed(name: str) -> None:
    parsed = NestedName.parse(name)
    assert not parsed.is_nested or NestedName.parse(parsed.port).port == parsed.port

"""Parsing definitions of ROS 1 and ROS 2."""

from __future__ import annotations

import contextlib
import time

import pytest

from bridge.messages.definitions.hashes import md5_sum, rihs01
from bridge.messages.definitions.schema import Definition, FieldType, Schema, Shape, World
from bridge.messages.definitions.text import closure, full_text, parse_definition, parse_full
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry

SEPARATOR = "=" * 80 + "\n"

TYPES = [
    ("int32", World.ROS1, FieldType("int32")),
    ("float64[36]", World.ROS1, FieldType("float64", Shape.ARRAY, 36)),
    ("string[]", World.ROS1, FieldType("string", Shape.SEQUENCE)),
    ("Header", World.ROS1, FieldType("std_msgs/Header")),
    ("Header", World.ROS2, FieldType("std_msgs/msg/Header")),
    ("Other", World.ROS1, FieldType("my_msgs/Other")),
    ("Other[]", World.ROS2, FieldType("my_msgs/msg/Other", Shape.SEQUENCE)),
    ("time", World.ROS1, FieldType("time")),
    ("time", World.ROS2, FieldType("builtin_interfaces/msg/Time")),
    ("builtin_interfaces/Duration", World.ROS1, FieldType("duration")),
    ("string<=10[<=5]", World.ROS2, FieldType("string", Shape.SEQUENCE, 5, 10)),
    ("wstring<=4", World.ROS2, FieldType("wstring", string_bound=4)),
    ("geometry_msgs/msg/Point[3]", World.ROS2, FieldType("geometry_msgs/msg/Point", Shape.ARRAY, 3)),
]


@pytest.mark.parametrize(("text", "world", "expected"), TYPES)
def test_types_of_fields_are_parsed(text: str, world: World, expected: FieldType):
    assert parse(f"{text} field", world).fields[0].type == expected


DEFAULTS = [
    ("int32 a -5", -5),
    ("uint8 a 0x1F", 31),
    ("float64 a 1", 1.0),
    ("bool a true", True),
    ("bool a 0", False),
    ('string a "with # sign"  # a comment', "with # sign"),
    ("int16[] a [1, 2 , -3]", (1, 2, -3)),
    ("string[2] a [\"x, y\", 'z']", ("x, y", "z")),
    ("int32 a # 7", None),
]


@pytest.mark.parametrize(("line", "expected"), DEFAULTS)
def test_default_values_are_parsed(line: str, expected: object):
    assert parse(line, World.ROS2).fields[0].default == expected


def test_constants_keep_their_text():
    definition = parse("float32 PI=3.140  # roughly\nstring NAME=  a # b \nbyte X = 0x10\nint8 y", World.ROS1)
    assert [(c.name, c.text) for c in definition.constants] == [("PI", "3.140"), ("NAME", "a # b"), ("X", "0x10")]
    assert [f.name for f in definition.fields] == ["y"]


BROKEN = [
    ("int32", "expected '<type> <name>'"),
    ("int32 a\nint32 a", "two fields named 'a'"),
    ("int32[0] a", "array length"),
    ("int32[99999999999] a", "array length"),
    ("int32<=3 a", "only strings"),
    ("int32 a five", "line 1"),
    ("Point a 5", "cannot have a default"),
    ("int32[2] a [1, 2, 3]", "3 default values for 2"),
    ("int32[] a 3", "list in brackets"),
    ("9int a", "is not a type"),
]


@pytest.mark.parametrize(("text", "reason"), BROKEN)
def test_parse_error_names_type_and_reason(text: str, reason: str):
    with pytest.raises(MessageTypeError, match=reason) as caught:
        parse(text, World.ROS2)
    assert "my_msgs/msg/Sample" in str(caught.value)


def test_a_full_definition_is_read_back_the_same():
    text = (
        "Header header\nOther[] others\n"
        + "=" * 80
        + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    )
    text += "=" * 80 + "\nMSG: my_msgs/Other\nuint8 a\n"
    definitions = parse_full(text, "my_msgs/Sample", World.ROS1)
    schema = closure(definitions["my_msgs/Sample"], definitions)
    again = parse_full(full_text(schema), "my_msgs/Sample", World.ROS1)
    assert md5_sum(closure(again["my_msgs/Sample"], again)) == md5_sum(schema)


def test_generated_text_has_the_same_meaning():
    """If a definition has no original text, the text generated from its fields has the same hash."""
    text = (
        'string<=10 a "x"\nint32[<=3] b\nOther c\nfloat64[2] d [1.5, 2]\n'
        + "=" * 80
        + "\nMSG: my_msgs/Other\nbool e true\n"
    )
    definitions = parse_full(text, "my_msgs/msg/Sample", World.ROS2)
    bare = {name: Definition(name, World.ROS2, d.fields, d.constants) for name, d in definitions.items()}
    schema = Schema(bare["my_msgs/msg/Sample"], bare)
    again = parse_full(full_text(schema), "my_msgs/msg/Sample", World.ROS2)
    assert again["my_msgs/msg/Sample"].fields == schema.root.fields
    assert rihs01(closure(again["my_msgs/msg/Sample"], again)) == rihs01(schema)


def test_a_type_that_contains_itself_is_refused():
    definitions = parse_full("Sample[] more", "my_msgs/Sample", World.ROS1)
    with pytest.raises(MessageTypeError, match="contains itself"):
        closure(definitions["my_msgs/Sample"], definitions)


def test_a_missing_nested_type_is_named():
    definitions = parse_full("other_msgs/Thing thing", "my_msgs/Sample", World.ROS1)
    with pytest.raises(MessageTypeError, match="nests other_msgs/Thing") as caught:
        closure(definitions["my_msgs/Sample"], definitions)
    assert "other_msgs" in caught.value.cure


def parse(text: str, world: World) -> Definition:
    return parse_definition(text, "my_msgs/Sample" if world is World.ROS1 else "my_msgs/msg/Sample", world)


def chain(count: int, width: int, last: str = "") -> str:
    """Return ``count`` types, each of which nests the next one ``width`` times."""
    parts = []
    for number in range(count):
        fields = "".join(f"my_msgs/T{number + 1} f{k}\n" for k in range(width))
        parts.append(fields if number == 0 else f"MSG: my_msgs/T{number}\n{fields}")
    return SEPARATOR.join([*parts, f"MSG: my_msgs/T{count}\n{last}"])


def test_types_that_nest_too_deep_are_refused():
    with pytest.raises(MessageTypeError, match="more than 64 deep"):
        Registry().ros1_to_hub("my_msgs/T0", definition=chain(1500, 1, "uint8 a\n"))


@pytest.mark.parametrize("last", ["", "uint8 a\n", "string a\n"])
def test_types_with_too_many_fields_are_refused_at_once(last: str):
    with pytest.raises(MessageTypeError, match="too large to be converted"):
        Registry().ros1_to_hub("my_msgs/T0", definition=chain(40, 10, last))


def test_overlong_lines_are_refused_at_once():
    with pytest.raises(MessageTypeError, match="longer than"):
        parse("string a " + "\"'" * 1_000_000, World.ROS2)
    assert parse("# " + "x" * 100_000 + "\nint8 a", World.ROS2).fields


@pytest.mark.parametrize("text", ["a" + "'" * 19_000 + "#", "string A=" + "'" * 19_000 + "#"])
def test_a_line_of_quotes_is_read_at_once(text: str) -> None:
    """A publisher's definition must not stop the worker for seconds."""
    began = time.thread_time()
    with contextlib.suppress(MessageTypeError):
        parse(text, World.ROS1)
    assert time.thread_time() - began < 1.0


def test_only_quotes_of_a_default_value_protect_a_number_sign() -> None:
    definition = parse("string a 'x # y' # it's\nint8 b # it's b\nstring C='x' # y\nint8 D=5 # 'z'", World.ROS2)
    assert [(field.name, field.default) for field in definition.fields] == [("a", "x # y"), ("b", None)]
    assert [(constant.name, constant.text) for constant in definition.constants] == [("C", "'x'"), ("D", "5")]

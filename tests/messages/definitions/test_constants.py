"""Constants and separators as genmsg, genaction and rosidl_adapter read them, and converted between ROS 1 and 2."""

from __future__ import annotations

import importlib
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from bridge.messages.definitions.constants import constant_value, is_readable, ros1_constants, ros2_constants
from bridge.messages.definitions.hashes import md5_sum
from bridge.messages.definitions.schema import Constant, Definition, World
from bridge.messages.definitions.text import own_text, parse_definition, split_parts
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from tests.peers.codecs import SYSTEM_PYTHON, needs_genpy
from tests.support.missing import ROS2, needs

CONSTANTS = [
    *[
        ("bool", text)
        for text in ("True", "False", "true", "FALSE", "1", "0", "2", "0x1", "yes", "'a'", "", "not True")
    ],
    *[("byte", text) for text in ("8", "08", "-1", "-128", "127", "128", "255", "256", "0x10", "0b1", "1_0", "eight")],
    *[("char", text) for text in ("65", "-1", "255", "'a'")],
    *[("int8", text) for text in ("-0128", "007", "0o17", "0x7F", "128", "1.0")],
    *[("uint64", text) for text in ("18446744073709551615", "18446744073709551617", "+5")],
    *[("float32", text) for text in ("3.140", "1e3", "-.5", "0x10", "one", "7")],
    *[("string", text) for text in ("plain", '"quoted"', "'it\\'s'", "'", '"half', '"a"b"')],
    ("wstring", '"wide"'),
    ("time", "1"),
]


def genmsg(items: list[dict[str, str]]) -> list[dict[str, Any]]:
    """Return the answers of ``genmsg_peer.py``, one for each item."""
    peer = Path(__file__).parents[2] / "peers" / "ros1" / "genmsg_peer.py"
    done = subprocess.run(
        [SYSTEM_PYTHON, peer], input=json.dumps(items), capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    answers: list[dict[str, Any]] = json.loads(done.stdout)
    return answers


def rosidl_value(base: str, text: str) -> Any:
    """Return the value that rosidl_adapter reads; None if it refuses the constant."""
    parser = importlib.import_module("rosidl_adapter.parser")
    try:
        spec = parser.parse_message_string("my_msgs", "Sample", f"{base} VALUE={text}\n")
    except Exception:
        return None
    return spec.constants[0].value


def own_value(base: str, text: str, world: World) -> Any:
    constant = Constant("VALUE", base, text)
    return constant_value(constant, world) if is_readable(constant, world) else None


@needs_genpy
def test_ros1_constants_are_read_as_genmsg_reads_them() -> None:
    answers = genmsg([{"kind": "msg", "text": f"{base} VALUE={text}\n"} for base, text in CONSTANTS])
    for (base, text), answer in zip(CONSTANTS, answers, strict=True):
        assert own_value(base, text, World.ROS1) == answer.get("constants", {}).get("VALUE"), (base, text, answer)


@needs(ROS2)
def test_ros2_constants_are_read_as_rosidl_reads_them() -> None:
    for base, text in CONSTANTS:
        if base != "time":  # rosidl_adapter fails with an assertion
            assert own_value(base, text, World.ROS2) == rosidl_value(base, text), (base, text)


@needs_genpy
@needs(ROS2)
def test_constants_keep_their_value_in_the_other_world() -> None:
    """One ROS version's tools read the original text as the other version's tools read the converted text."""
    ros1 = [Constant("VALUE", base, text) for base, text in CONSTANTS]
    readable = [(constant, ros1_constants([constant])) for constant in ros1 if is_readable(constant, World.ROS2)]
    readable = [(constant, constants) for constant, constants in readable if constant.base != "wstring"]
    answers = genmsg([{"kind": "msg", "text": f"{c.base} VALUE={c.text}\n"} for _, (c,) in readable])
    for (constant, _), answer in zip(readable, answers, strict=True):
        value = constant_value(constant, World.ROS2)
        signed = value - 256 if constant.base == "byte" and isinstance(value, int) and value > 127 else value
        assert answer["constants"]["VALUE"] == signed, (constant, answer)
    for constant in ros1:
        if is_readable(constant, World.ROS1):
            (translated,) = ros2_constants([constant])
            value = constant_value(constant, World.ROS1)
            unsigned = value & 0xFF if constant.base == "byte" and isinstance(value, int) else value
            line = own_text(Definition("my_msgs/msg/Sample", World.ROS2, (), (translated,))).strip()
            assert rosidl_value(*line.split(" VALUE=")) == unsigned, (constant, line)


def test_a_bool_of_ros2_is_a_number_in_ros1(tmp_path: Path) -> None:
    """Genmsg evaluates the value as a Python literal, which 1 is, but ``true`` is not."""
    package = tmp_path / "my_msgs"
    package.mkdir()
    (package / "Flag.msg").write_text("bool ON=true\nbool OFF=FALSE\nuint8 MASK=0x1F\nbyte LOW=08\nbool lit\n")
    (package / "Only.msg").write_text("bool ON=true\n")
    (package / "Both.msg").write_text("bool ON=True\nbyte LOW=08\n")
    registry = Registry(folders=[tmp_path])
    assert registry.ros1("my_msgs/Flag").definition == "bool ON=1\nbool OFF=0\nuint8 MASK=31\nbyte LOW=08\nbool lit\n"
    assert registry.ros1("my_msgs/Only").definition == "bool ON=1\n"
    assert registry.ros1("my_msgs/Both").definition == "bool ON=True\nbyte LOW=08\n"  # the md5 sum covers the text
    assert registry.ros2("my_msgs/msg/Both").definition == "bool ON=True\nbyte LOW=08\n"


def test_names_and_values_of_ros1_become_legal_in_ros2(tmp_path: Path) -> None:
    (tmp_path / "my_msgs").mkdir()
    (tmp_path / "my_msgs" / "Odd.msg").write_text("byte low=-1\nbool yes=3\nint32 value\n")
    registry = Registry(folders=[tmp_path])
    assert registry.ros2("my_msgs/msg/Odd").definition == "byte LOW=255\nbool YES=true\nint32 value\n"
    assert registry.ros2_package_sources("my_msgs")["msg/Odd.msg"] == "byte LOW=255\nbool YES=true\nint32 value\n"


def test_a_constant_that_neither_world_reads_is_named(tmp_path: Path) -> None:
    (tmp_path / "my_msgs").mkdir()
    (tmp_path / "my_msgs" / "Mode.msg").write_text("byte LOW=1\nbool ON=yes\nint32 value\n")
    with pytest.raises(MessageTypeError, match=r"my_msgs/Mode, line 2 .*ROS 1 writes True, False, 1 or 0"):
        Registry(folders=[tmp_path]).ros1("my_msgs/Mode")


@needs_genpy
def test_md5_sums_cover_a_constant_as_it_is_written() -> None:
    texts = ["bool ON=True\nbyte LOW=08\n", "bool ON = 1\nint8 a\n", "char A=065\nfloat32 PI=3.140\n"]
    for text, answer in zip(texts, genmsg([{"kind": "msg", "text": text} for text in texts]), strict=True):
        registry = Registry()
        registry.learn_ros1("my_msgs/Sample", text)
        assert md5_sum(registry.ros1_schema("my_msgs/Sample")) == answer["md5"], text


SEPARATORS = ["---", "----", "--------------------", "--- # reply", "---# reply", "---\t", "--- ---"]


@needs_genpy
@pytest.mark.parametrize("separator", SEPARATORS)
def test_separators_are_those_of_genmsg_and_genaction(separator: str) -> None:
    service = f"bool a\n{separator}\nbool b\n"
    action = f"# goal\nbool a\n{separator}\n{separator}\r\nbool c # --- no separator\n"
    for item, names in (({"kind": "srv", "text": service}, "ab"), ({"kind": "action", "text": action}, "a c")):
        (answer,) = genmsg([item])
        definitions = [parse_definition(part, "my_msgs/Sample", World.ROS1) for part in split_parts(item["text"])]
        fields = [[field.name for field in part.fields] for part in definitions]
        assert answer["parts"] == fields == [list(name.strip()) for name in names]


@needs_genpy
def test_a_service_of_several_separators_is_read_as_genmsg_reads_it(tmp_path: Path) -> None:
    (tmp_path / "my_srvs").mkdir()
    text = "bool a\n---\nbool b\n----\nbool c\n---\n"
    (answer,) = genmsg([{"kind": "srv", "text": text}])
    (tmp_path / "my_srvs" / "srv").mkdir()
    (tmp_path / "my_srvs" / "srv" / "Ask.srv").write_text(text)
    registry = Registry(folders=[tmp_path])
    assert answer["parts"] == [["a"], ["b", "c"]]
    assert registry.service_ros1_to_hub("my_srvs/Ask").side.type_id == answer["md5"]
    assert registry.ros2_package_sources("my_srvs") == {"srv/Ask.srv": "bool a\n---\nbool b\nbool c\n\n"}


def test_bools_of_idl_files_become_numbers_too(tmp_path: Path) -> None:
    (tmp_path / "my_msgs").mkdir()
    idl = "module Flag_Constants { const boolean ON = TRUE; const octet MASK = 200; }; struct Flag { octet a; };"
    (tmp_path / "my_msgs" / "Flag.idl").write_text(f"module my_msgs {{ module msg {{ {idl} }}; }};")
    registry = Registry(folders=[tmp_path])
    assert registry.ros1("my_msgs/Flag").definition == "bool ON=1\nbyte MASK=-56\nbyte a\n"
    assert registry.ros2("my_msgs/msg/Flag").definition == "bool ON=True\nbyte MASK=200\nbyte a\n"


@pytest.mark.parametrize("separator", SEPARATORS)
def test_both_worlds_have_a_service_and_an_action_of_any_separator(tmp_path: Path, separator: str) -> None:
    for kind in ("srv", "action"):
        (tmp_path / "my_acts" / kind).mkdir(parents=True)
    (tmp_path / "my_acts/srv/Ask.srv").write_text(f"bool value\n{separator}\nbool ok\n")
    (tmp_path / "my_acts/action/Go.action").write_text(f"int32 a\n{separator}\nint32 b\n{separator}\nint32 c\n")
    registry = Registry(folders=[tmp_path])
    plain = Registry()
    plain.learn_ros1("my_acts/GoGoal", "int32 a\n")
    assert registry.service_ros1_to_hub("my_acts/Ask").side.definition == "bool value\n---\nbool ok\n"
    assert registry.service_hub_to_ros1("my_acts/srv/Ask").hub.name == "my_acts/srv/Ask"
    assert registry.ros1_action("my_acts/Go").goal.definition.startswith("Header header\n")
    assert own_text(registry.ros1_schema("my_acts/GoGoal").root) == "int32 a\n"
    assert registry.hub_to_ros1("my_acts/action/Go_FeedbackMessage").target.name == "my_acts/action/Go_FeedbackMessage"

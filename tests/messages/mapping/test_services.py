"""Services: MD5 sums, hashes and bytes as ROS has them; pairing, derived types, and errors."""

from __future__ import annotations

import base64
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.interfaces import bundled_files, bundled_packages
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import ServiceConversion
from tests.messages.samples import GENPY, sample
from tests.peers.codecs import base64_text, genpy, needs_genpy, rclpy

KNOWN_MD5 = {  # seen on the wire of a running navigation stack
    "nav_msgs/GetMap": "6cdd0a18e0aff5b0a3ca2326a89b54ff",
    "nav_msgs/GetPlan": "421c8ea4d21c6c9db7054b4bbdf1e024",
    "nav_msgs/LoadMap": "22e647fdfbe3b23c8c9f419908afaebd",
    "nav_msgs/SetMap": "c36922319011e63ed7784112ad4fdd32",
    "std_srvs/Empty": "d41d8cd98f00b204e9800998ecf8427e",
}
ROS1 = sorted(f"{path.parts[-3]}/{path.stem[1:]}" for path in GENPY.glob("*/srv/_[A-Z]*.py"))


def ros2_services() -> list[str]:
    """Return every service for which rclpy has a class."""
    installed = {f"{p.parts[-3]}/srv/{p.stem}" for p in (Path(sys.prefix) / "share").glob("*/srv/*.srv")}
    bundled = {f"{pkg}/{path.removesuffix('.srv')}" for pkg in bundled_packages() for path in bundled_files(pkg)}
    return sorted(installed | {name for name in bundled if "/srv/" in name})


def parts(name: str, conversion: ServiceConversion) -> Iterator[tuple[str, Callable[..., bytes], Callable[..., bytes]]]:
    """Yield the name of each of a service's two messages, with its converters to ROS 1 and to the hub."""
    for part in ("Request", "Response"):
        both = (getattr(conversion, f"{part.lower()}_to_{where}") for where in ("side", "hub"))
        yield f"{name}_{part}", *both


@needs_genpy
@pytest.mark.parametrize("name", ROS1)
def test_md5_sums_are_those_of_rospy(name: str, registry: Registry):
    package, short = name.split("/")
    announced = re.findall(r"""_md5sum = ["'](\w+)["']""", (GENPY / package / "srv" / f"_{short}.py").read_text())[-1]
    conversion = registry.service_ros1_to_hub(name, announced)
    assert (conversion.side.name, conversion.side.type_id) == (name, announced)
    assert announced == KNOWN_MD5.get(name, announced)


@needs_genpy
@pytest.mark.parametrize("name", ROS1)
def test_mapping_a_type_to_the_hub_and_back_gives_the_same_type(name: str, registry: Registry):
    from_ros1 = registry.service_ros1_to_hub(name)
    from_hub = registry.service_hub_to_ros1(from_ros1.hub.name, from_ros1.hub.type_id)
    assert (from_hub.side, from_hub.hub, from_hub.left_out) == (from_ros1.side, from_ros1.hub, ())
    assert registry.service_ros2(from_ros1.hub.name, from_ros1.hub.type_id) == from_ros1.hub


@needs_genpy
def test_standard_services_are_known_where_ros1_is_not_installed(registry: Registry):
    bare = Registry(ros1_packages=Path("/nonexistent"))
    known = [name for name in ROS1 if not name.startswith("roscpp/")]
    assert len(known) > 15
    for name in known:
        assert bare.service_ros1_to_hub(name).side.type_id == registry.service_ros1_to_hub(name).side.type_id, name


def test_hashes_are_those_of_rclpys_type_support(registry: Registry):
    names = ros2_services()
    assert len(names) > 40
    for name, answer in zip(names, rclpy([{"hash": name} for name in names]), strict=True):
        assert registry.service_ros2(name).type_id == answer.get("hash"), (name, answer)


@needs_genpy
def test_ros1_bytes_are_those_of_rospy(registry: Registry):
    """CDR converted to ROS 1 equals genpy's output byte for byte, and is converted back to the same CDR."""
    items, cdrs, backs = [], [], []
    for name in ROS1:
        conversion = registry.service_ros1_to_hub(name)
        for part, to_side, to_hub in parts(conversion.hub.name, conversion):
            for length in (0, 1, 3):
                values = sample(registry.schema(part), length)
                cdrs.append(from_json(registry, part, values))
                backs.append(to_hub)
                ros1 = part.replace(conversion.hub.name, name.replace("/", "/srv/"))
                items.append({"type": ros1, "definition": "", "values": values, "ros1": base64_text(to_side(cdrs[-1]))})
    for item, cdr, to_hub, answer in zip(items, cdrs, backs, genpy(items), strict=True):
        assert answer.get("same"), (item["type"], answer)
        assert answer["bytes"] == item["ros1"], item["type"]
        assert to_hub(base64.b64decode(answer["bytes"])) == cdr, item["type"]


def test_cdr_bytes_are_those_of_rclpy(registry: Registry):
    """Rclpy can read our CDR, and CDR from rclpy is accepted, trimmed of trailing padding, and has the same values."""
    items = []
    for name in ros2_services():
        for part in ("Request", "Response"):
            for length in (0, 1, 3):
                values = sample(registry.schema(f"{name}_{part}"), length)
                cdr = from_json(registry, f"{name}_{part}", values)
                items.append({"type": f"{name}_{part}", "values": values, "cdr": base64_text(cdr)})
    for item, answer in zip(items, rclpy(items), strict=True):
        name, ours = item["type"], base64.b64decode(item["cdr"])
        assert answer.get("same"), (name, answer)
        check = registry.hub_service_check(name.rpartition("_")[0])[name.endswith("_Response")]
        theirs = check(base64.b64decode(answer["bytes"]))
        assert len(theirs) == len(ours), name
        assert to_json(registry, name, theirs) == to_json(registry, name, ours), name


@needs_genpy
def test_invalid_request_bytes_are_rejected(registry: Registry):
    conversion = registry.service_ros1_to_hub("nav_msgs/GetPlan")
    for convert, wrong in ((conversion.request_to_hub, b"\1\2\3"), (conversion.response_to_side, b"\0\1\0\0\1")):
        assert convert is not None
        with pytest.raises(ConversionError, match="bad nav_msgs"):
            convert(wrong)
    check_request, check_response = registry.hub_service_check("std_srvs/srv/SetBool")
    assert check_request(b"\0\1\0\0\1") == b"\0\1\0\0\1"
    with pytest.raises(ConversionError):
        check_response(b"\0\1\0\0\1")


def test_unknown_service_is_reported_with_its_cure(registry: Registry):
    for ask, name in (
        (registry.service_ros1_to_hub, "nobody_srvs/Ask"),
        (registry.service_hub_to_ros1, "nobody_srvs/srv/Ask"),
        (registry.service_ros2, "nobody_srvs/srv/Ask"),
    ):
        with pytest.raises(MessageTypeError, match=r"no definition of the ROS [12] service nobody_srvs") as caught:
            ask(name)
        assert ".srv files" in caught.value.cure
    for name in ("", "a", "a/b/c/d", "../../etc/passwd", "std_msgs/msg/String", "std_srvs/srv/SetBool_Request"):
        with pytest.raises(MessageTypeError):
            registry.service_ros2(name)
        with pytest.raises(MessageTypeError):
            registry.service_ros1_to_hub(name)
        with pytest.raises(MessageTypeError):
            registry.service_hub_to_ros1(name)


def test_different_md5_or_hash_is_reported(registry: Registry):
    with pytest.raises(MessageTypeError, match="has the md5 0123 there but 09fb03525b03e7ea1fd3992bafd87e16 here"):
        registry.service_ros1_to_hub("std_srvs/SetBool", "0123")
    with pytest.raises(MessageTypeError, match=r"has the hash RIHS01_00 there but RIHS01_\w{64} here"):
        registry.service_hub_to_ros1("std_srvs/srv/SetBool", "RIHS01_00")
    assert registry.service_ros1_to_hub("std_srvs/SetBool", "*") is registry.service_ros1_to_hub("std_srvs/SetBool")


ASK = "Header header\nstring Question\nMark mark\n---\nuint8 YES=1\ntime at\nmy_srvs/Mark[] marks\n"


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """Return a folder with a package, as written for ROS 1."""
    for path, content in {"srv/ask_me.srv": ASK, "msg/Mark.msg": "uint8 kind\nint32 age\n"}.items():
        file = tmp_path / "my_srvs" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)
    return tmp_path


def test_a_service_that_exists_only_in_ros1_is_derived(folders: Path):
    registry = Registry(folders=[folders])
    from_ros1 = registry.service_ros1_to_hub("my_srvs/ask_me")
    assert from_ros1.hub.name == "my_srvs/srv/AskMe"
    from_hub = registry.service_hub_to_ros1(from_ros1.hub.name, from_ros1.hub.type_id)
    assert from_hub.side == from_ros1.side
    values = sample(registry.schema("my_srvs/srv/AskMe_Request"))
    assert list(values) == ["header", "question", "mark"]
    cdr = from_json(registry, "my_srvs/srv/AskMe_Request", values)
    assert from_ros1.request_to_side is not None
    assert from_ros1.request_to_hub is not None
    assert from_ros1.request_to_hub(from_ros1.request_to_side(cdr)) == cdr
    files = registry.ros2_package_sources("my_srvs")
    assert files["srv/AskMe.srv"].split("---\n")[1].startswith("uint8 YES=1\nbuiltin_interfaces/Time at")


def test_a_service_that_exists_only_in_ros2_is_derived(tmp_path: Path):
    folder = tmp_path / "my_srvs" / "srv"
    folder.mkdir(parents=True)
    (folder / "Ask.srv").write_text("string<=5 question 'why'\n---\nbuiltin_interfaces/Time at\nint32[<=2] marks\n")
    registry = Registry(folders=[tmp_path])
    from_hub = registry.service_hub_to_ros1("my_srvs/srv/Ask")
    assert from_hub.side.name == "my_srvs/Ask"
    assert from_hub.side.definition == "string question\n---\ntime at\nint32[] marks\n"
    from_ros1 = registry.service_ros1_to_hub("my_srvs/Ask", from_hub.side.type_id)
    assert from_ros1.hub == from_hub.hub
    assert from_hub.request_to_hub is not None
    with pytest.raises(ConversionError, match="longer than its type allows"):
        from_hub.request_to_hub(b"\6\0\0\0sixsix")


def test_service_announced_on_the_hub_is_known_by_its_hash(folders: Path):
    announced = Registry(folders=[folders]).service_ros1_to_hub("my_srvs/ask_me").hub
    registry = Registry()
    with pytest.raises(MessageTypeError):
        registry.service_ros2(announced.name, announced.type_id)
    registry.learn_ros2(announced.name, announced.definition)
    known = registry.service_ros2(announced.name, announced.type_id)
    assert (known.type_id, known.definition) == (announced.type_id, announced.definition)
    derived = registry.service_hub_to_ros1(announced.name, announced.type_id)
    assert derived.side.name == "my_srvs/AskMe"
    assert registry.ros2_package_sources("my_srvs")["srv/AskMe.srv"].startswith("std_msgs/Header header\n")
    # The definition that the network uses has priority over a derived one.
    both = Registry(folders=[folders])
    both.learn_ros2("my_srvs/srv/AskMe", announced.definition)
    assert both.service_ros1_to_hub("my_srvs/ask_me").hub.type_id == announced.type_id


@pytest.mark.parametrize(
    ("definition", "reason"), [("string a\n", "1 parts"), ("---\n---\n", "3 parts"), ("a\n---\n", "line 1")]
)
def test_announced_definition_must_be_a_service(definition: str, reason: str):
    with pytest.raises(MessageTypeError, match=reason):
        Registry().learn_ros2("my_srvs/srv/Ask", definition)


RULES = """
- ros1_package_name: my_srvs
  ros1_service_name: ask_me
  ros2_package_name: your_srvs
  ros2_service_name: Tell
  request_fields_1_to_2: {Question: text, header.stamp: when}
  response_fields_1_to_2: {marks: all}
"""


def test_a_mapping_rule_bridges_services_with_other_names_and_fields(folders: Path, tmp_path: Path):
    (folders / "your_srvs" / "srv").mkdir(parents=True)
    (folders / "your_srvs" / "srv" / "Tell.srv").write_text(
        "builtin_interfaces/Time when\nstring text\nbool loud true\n---\nint8 more\nmy_srvs/Mark[] all\n"
    )
    rules = tmp_path / "rules.yaml"
    rules.write_text(RULES)
    registry = Registry(folders=[folders], mapping_rules=[rules])
    service = registry.service_ros1_to_hub("my_srvs/ask_me")
    assert service.hub.name == "your_srvs/srv/Tell"
    assert registry.service_hub_to_ros1("your_srvs/srv/Tell").side == service.side
    assert service.request_to_hub is not None
    request = b"\7\0\0\0\1\0\0\0\2\0\0\0\0\0\0\0\3\0\0\0why\1\3\0\0\0"
    hub_request = to_json(registry, "your_srvs/srv/Tell_Request", service.request_to_hub(request))
    assert hub_request == {"when": {"sec": 1, "nanosec": 2}, "text": "why", "loud": True}
    answer: dict[str, Any] = {"more": 5, "all": [{"kind": 9, "age": 3}]}
    assert service.response_to_side is not None
    response = service.response_to_side(from_json(registry, "your_srvs/srv/Tell_Response", answer))
    assert response == bytes(8) + b"\1\0\0\0\x09\3\0\0\0"


def test_two_ints_maps_to_add_two_ints_of_example_interfaces(tmp_path: Path):
    """TwoInts follows example_interfaces' mapping rule; without an AddTwoInts definition, its ROS 2 type is derived."""
    for name in ("roscpp_tutorials/srv/TwoInts.srv", "example_interfaces/srv/AddTwoInts.srv"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text("int64 a\nint64 b\n---\nint64 sum\n")
    registry = Registry(folders=[tmp_path], ros1_packages=Path("/nonexistent"))
    assert registry.service_ros1_to_hub("roscpp_tutorials/TwoInts").hub.name == "example_interfaces/srv/AddTwoInts"
    back = registry.service_hub_to_ros1("example_interfaces/srv/AddTwoInts")
    assert back.side.type_id == "6a2e34150c00229791cc89ff309fff21"  # the md5 sum in roscpp_tutorials
    (tmp_path / "example_interfaces/srv/AddTwoInts.srv").unlink()
    registry = Registry(folders=[tmp_path])
    assert registry.service_ros1_to_hub("roscpp_tutorials/TwoInts").hub.name == "roscpp_tutorials/srv/TwoInts"


def test_services_with_the_same_name_but_other_fields_are_not_paired(folders: Path):
    registry = Registry(folders=[folders])
    # announced by the hub, but the installed definition is kept
    registry.learn_ros2("std_srvs/srv/SetBool", "bool data\n---\nbool done\n")
    assert registry.service_ros1_to_hub("std_srvs/SetBool").hub == registry.service_ros2("std_srvs/srv/SetBool")
    other = folders / "std_srvs" / "srv"
    other.mkdir(parents=True)
    (other / "SetBool.srv").write_text("float32 Header\nHeader data\n---\nbool success\nstring message\n")
    with pytest.raises(MessageTypeError, match="std_srvs/srv/SetBool_Request do not match") as caught:
        Registry(folders=[folders]).service_ros1_to_hub("std_srvs/SetBool")
    assert "mapping rule" in caught.value.cure


def test_idl_files_alone_define_a_service(tmp_path: Path, registry: Registry):
    share = tmp_path / "share" / "std_srvs" / "srv"
    share.mkdir(parents=True)
    idl = (Path(sys.prefix) / "share" / "std_srvs" / "srv" / "SetBool.idl").read_text()
    (share / "Other.idl").write_text(idl.replace("SetBool", "Other"))
    service = Registry(prefixes=[tmp_path]).service_ros2("std_srvs/srv/Other")
    assert service.definition == "bool data\n---\nbool success\nstring message\n"
    assert registry.service_ros2("std_srvs/srv/SetBool").type_id != service.type_id

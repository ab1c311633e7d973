"""Folders of files that nest types whose syntax or names are legal in only one ROS version."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.interfaces.definition import read_package
from bridge.interfaces.folders import read_folders
from bridge.messages.errors import MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.messages.samples import sample

ROS1_FORM = "Header header\ntime when\n"
ROS2_FORM = "builtin_interfaces/Duration length\nstring<=8 name\nint32 level 5\n"

NESTS = [
    {"Outer": "Inner[] items\n", "Inner": ROS1_FORM},
    {"Outer": "Inner[] items\n", "Inner": ROS2_FORM},
    {"Outer": "Middle[2] items\n", "Middle": "my_robot/Inner one\n", "Inner": ROS1_FORM},
    {"Outer": "Middle[2] items\n", "Middle": "my_robot/Inner one\n", "Inner": ROS2_FORM},
    {"Outer": "Inner a\nNote b\nInner[] c\n", "Inner": ROS1_FORM, "Note": ROS2_FORM},
    {"Outer": "Inner a\n", "Inner": f"{ROS1_FORM}Note note\n", "Note": ROS2_FORM},
    {"Outer": "Note a\n", "Note": f"{ROS2_FORM}Inner inner\n", "Inner": ROS1_FORM},
    {"Outer": "Note a\nTwo b\n", "Note": f"{ROS2_FORM}Two two\n", "Two": "Inner inner\n", "Inner": ROS1_FORM},
    {"Outer": "Inner a\n", "Inner": "int32 Value\nbyte low=-1\n"},
    {"Outer": "Inner a\n", "Inner": "bool ON=true\n"},
    {"Outer": "an_inner a\n", "an_inner": "int32 a\n"},
    {"Outer": "Inner[] a\nInner A\n", "Inner": "float64 T\nfloat64 t\nint32 N=1\nint32 n=2\n"},
]


def registry(tmp_path: Path, files: dict[str, str]) -> Registry:
    """A registry with the messages, services and actions of one package; a service has one separator, an action two."""
    for name, text in files.items():
        kind = ("msg", "srv", "action")[text.count("---\n")]
        file = tmp_path / "my_robot" / kind / f"{name}.{kind}"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    return Registry(folders=[tmp_path], ros1_packages=Path("/nonexistent"))


@pytest.mark.parametrize("files", NESTS)
def test_each_world_has_all_nested_types(tmp_path: Path, files: dict[str, str]) -> None:
    package_registry = registry(tmp_path, files)
    to_ros1, to_hub = package_registry.hub_to_ros1("my_robot/msg/Outer"), package_registry.ros1_to_hub("my_robot/Outer")
    assert (to_ros1.source, to_ros1.target) == (to_hub.target, to_hub.source)
    cdr = from_json(package_registry, "my_robot/msg/Outer", sample(package_registry.schema("my_robot/msg/Outer"), 2))
    assert to_ros1.convert is not None
    assert to_hub.convert is not None
    assert to_hub.convert(to_ros1.convert(cdr)) == cdr
    assert to_json(package_registry, "my_robot/msg/Outer", cdr)


@pytest.mark.parametrize("first", ["ros1", "ros2", "service", "action"])
@pytest.mark.parametrize("files", NESTS)
def test_services_and_actions_may_nest_these_types(tmp_path: Path, files: dict[str, str], first: str) -> None:
    """The order in which types are requested does not matter."""
    package_registry = registry(
        tmp_path, {**files, "Ask": "Outer wanted\n---\nOuter[] had\n", "Go": "Outer a\n---\nOuter b\n---\nOuter c\n"}
    )
    lookups = {
        "ros1": lambda: package_registry.ros1_action("my_robot/Go").goal.name,
        "ros2": lambda: package_registry.service_hub_to_ros1("my_robot/srv/Ask").side.name,
        "service": lambda: package_registry.service_ros1_to_hub("my_robot/Ask").hub.name,
        "action": lambda: package_registry.service_ros1_to_hub("my_robot/action/Go_SendGoal").hub.name,
    }
    assert lookups.pop(first)()
    assert [lookup() for lookup in lookups.values()]
    assert (
        package_registry.service_ros1_to_hub("my_robot/Ask").hub
        == package_registry.service_hub_to_ros1("my_robot/srv/Ask").hub
    )
    feedback = package_registry.hub_to_ros1("my_robot/action/Go_FeedbackMessage")
    assert feedback.target.name == "my_robot/action/Go_FeedbackMessage"


@pytest.mark.parametrize("files", NESTS)
def test_the_package_can_be_built_for_ros2(tmp_path: Path, files: dict[str, str]) -> None:
    """Rosidl accepts every file of the package, whichever ROS version's spelling its author used."""
    package_registry = registry(tmp_path, {**files, "Ask": f"{ROS1_FORM}---\nOuter[] had\n"})
    sources = package_registry.ros2_package_sources("my_robot")
    assert {file.path for file in read_package("my_robot", sources)} >= {"msg/Outer.msg", "srv/Ask.srv"}
    assert "std_msgs/Header header" in sources["srv/Ask.srv"]


@pytest.mark.parametrize("goal", ["Header header\n", "builtin_interfaces/Duration wait\n"])
def test_an_action_may_be_written_for_either_world(tmp_path: Path, goal: str) -> None:
    package_registry = registry(tmp_path, {"Go": f"{goal}---\nInner[] seen\n---\nfloat32 left\n", "Inner": ROS1_FORM})
    send_goal = package_registry.service_ros1_to_hub("my_robot/action/Go_SendGoal")
    assert send_goal.hub == package_registry.service_hub_to_ros1("my_robot/action/Go_SendGoal").hub
    assert package_registry.ros1_action("my_robot/Go").result.name == "my_robot/GoActionResult"
    assert "action/Go.action" in package_registry.ros2_package_sources("my_robot")
    assert read_package("my_robot", package_registry.ros2_package_sources("my_robot"))


def test_a_file_that_mixes_both_spellings_is_named(tmp_path: Path) -> None:
    """Neither genmsg nor rosidl can read such a file."""
    package_registry = registry(
        tmp_path, {"Mixed": "Header header\nstring<=8 name\n", "Ask": "time a\n---\nint32 b 5\n"}
    )
    for ask in (package_registry.ros1_to_hub, package_registry.ros1, package_registry.service_ros1_to_hub):
        name = "Ask" if ask == package_registry.service_ros1_to_hub else "Mixed"
        with pytest.raises(MessageTypeError, match=rf"{name}\.\w+ mixes syntax of ROS 1 only") as caught:
            ask(f"my_robot/{name}")
        assert "std_msgs/Header" in caught.value.cure


def test_types_that_nest_each_other_across_the_worlds_are_refused(tmp_path: Path) -> None:
    package_registry = registry(tmp_path, {"One": "Header header\nTwo two\n", "Two": f"{ROS2_FORM}One one\n"})
    for name in ("my_robot/One", "my_robot/Two"):
        with pytest.raises(MessageTypeError, match="nest each other endlessly"):
            package_registry.ros1_to_hub(name)


def test_many_types_that_change_the_world_each_time_are_refused(tmp_path: Path) -> None:
    files = {f"T{n}": ("time" if n % 2 else "string<=3") + f" a\nT{n + 1} b\n" for n in range(300)}
    package_registry = registry(tmp_path, {**files, "T300": "int32 a\n"})
    with pytest.raises(MessageTypeError, match=r"nest each other|nested more than 64 deep"):
        package_registry.ros1_to_hub("my_robot/T0")


def test_a_type_that_ros1_cannot_have_is_still_named(tmp_path: Path) -> None:
    package_registry = registry(tmp_path, {"Outer": "Inner a\n", "Inner": "wstring text\n"})
    with pytest.raises(MessageTypeError, match="field text is a wstring"):
        package_registry.hub_to_ros1("my_robot/msg/Outer")
    assert package_registry.ros2("my_robot/msg/Outer").definition.startswith("Inner a\n")


def test_a_type_of_an_installed_ros1_package_is_nested_in_ros2(tmp_path: Path) -> None:
    packages = tmp_path / "python" / "old_msgs" / "msg"
    packages.mkdir(parents=True)
    (packages / "_Mark.py").write_text('class Mark:\n  _full_text = """int32 Number\n"""\n')
    folder = tmp_path / "types" / "my_robot"
    folder.mkdir(parents=True)
    (folder / "Outer.msg").write_text("old_msgs/Mark[] marks\nstring<=4 name\n")
    package_registry = Registry(folders=[folder.parent], ros1_packages=packages.parents[1])
    assert "int32 number" in package_registry.ros2("my_robot/msg/Outer").definition
    assert package_registry.hub_to_ros1("my_robot/msg/Outer").target.definition.startswith("old_msgs/Mark[] marks\n")


@pytest.mark.parametrize("path", ["checkout-main", "checkout-main/msg", "", "own", "link", "link_msg", "own/msg/.."])
def test_a_package_has_its_own_name_in_any_folder(tmp_path: Path, path: str) -> None:
    """The name is the one in ``package.xml`` or else that of the folder itself, not of a link to the folder."""
    for name, title in (("checkout-main", "my_robot"), ("own", "")):
        folder = tmp_path / "src" / name
        (folder / "msg").mkdir(parents=True)
        (folder / "msg" / "Outer.msg").write_text("Inner inner\n")
        (folder / "msg" / "Inner.msg").write_text("int32 a\n")
        (folder / "srv").mkdir()
        (folder / "srv" / "Ask.srv").write_text("Inner inner\n---\n")
        if title:
            (folder / "package.xml").write_text(f"<package><name>{title}</name></package>")
    (tmp_path / "src" / "link").symlink_to(tmp_path / "src" / "own")
    (tmp_path / "src" / "link_msg").symlink_to(tmp_path / "src" / "own" / "msg")
    package = "own" if "own" in path or "link" in path else "my_robot"
    package_registry = Registry(folders=[tmp_path / "src" / path], ros1_packages=Path("/nonexistent"))
    assert package_registry.ros1(f"{package}/Outer").definition == package_registry.ros2(
        f"{package}/msg/Outer"
    ).definition.replace(f"{package}/Inner inner", "Inner inner")
    assert package_registry.hub_to_ros1(f"{package}/msg/Outer").target.name == f"{package}/Outer"
    if not path.endswith("msg"):
        assert package_registry.service_ros2(f"{package}/srv/Ask").name == f"{package}/srv/Ask"


@pytest.mark.parametrize("text", ["int32 a\n", "# words\r\nint32 a\r\n"])
def test_a_byte_order_mark_is_not_part_of_a_definition(tmp_path: Path, text: str) -> None:
    files = {"Outer": f"\ufeff{text}", "Ask": f"\ufeff---\n{text}", "Go": f"\ufeff---\n---\n{text}"}
    package_registry = registry(tmp_path, files)
    assert (
        package_registry.ros2("my_robot/msg/Outer").type_id
        == registry(tmp_path / "plain", {"Outer": text}).ros2("my_robot/msg/Outer").type_id
    )
    assert package_registry.ros1_action("my_robot/Go").feedback.definition
    assert package_registry.service_ros1_to_hub("my_robot/Ask").hub.name == "my_robot/srv/Ask"
    [package] = read_folders([tmp_path / "my_robot"]).items()
    assert len(read_package(*package)) == len(files)

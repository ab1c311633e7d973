"""The registry: sources of definitions and their priority, and derived counterparts."""

from __future__ import annotations

import struct
import threading
from pathlib import Path

import pytest

from bridge.config.model import TypesSection
from bridge.messages.errors import MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.messages.samples import DATA, GENPY, sample

SEPARATOR = "=" * 80 + "\n"
PAIRS = [
    ("std_msgs/String", "std_msgs/msg/String"),
    ("std_msgs/Time", "builtin_interfaces/msg/Time"),
    ("std_msgs/Duration", "builtin_interfaces/msg/Duration"),
    ("rosgraph_msgs/Log", "rcl_interfaces/msg/Log"),
    ("tf2_msgs/TFMessage", "tf2_msgs/msg/TFMessage"),
    ("octomap_msgs/Octomap", "octomap_msgs/msg/Octomap"),
    ("actionlib_msgs/GoalStatusArray", "actionlib_msgs/msg/GoalStatusArray"),
]


@pytest.mark.parametrize(("ros1", "ros2"), PAIRS)
def test_mapping_a_type_to_the_hub_and_back_gives_the_same_type(registry: Registry, ros1: str, ros2: str):
    to_hub, to_ros1 = registry.ros1_to_hub(ros1), registry.hub_to_ros1(ros2)
    assert (to_hub.source.name, to_hub.target.name) == (ros1, ros2)
    assert (to_ros1.source.name, to_ros1.target.name) == (ros2, ros1)
    assert to_hub.source == to_ros1.target
    assert to_hub.target == to_ros1.source


THREE_D = [
    "octomap_msgs/msg/Octomap",
    "octomap_msgs/msg/OctomapWithPose",
    "grid_map_msgs/msg/GridMap",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Image",
    "visualization_msgs/msg/MarkerArray",
]


@pytest.mark.parametrize("name", THREE_D)
def test_maps_and_clouds_survive_the_round_trip_through_ros1(name: str):
    """No ROS 1 packages are installed. The fields that only ROS 2's Marker has are left at their default values."""
    registry = Registry(ros1_packages=Path("/nonexistent"))
    message = sample(registry.schema(name), 3)
    for marker in message.get("markers", []):
        for added in ("texture_resource", "texture", "uv_coordinates", "mesh_file"):
            del marker[added]
    cdr = from_json(registry, name, message)
    to_ros1 = registry.hub_to_ros1(name)
    assert to_ros1.convert is not None
    to_hub = registry.ros1_to_hub(to_ros1.target.name)
    assert to_hub.convert is not None
    assert to_hub.convert(to_ros1.convert(cdr)) == cdr


def test_the_header_of_a_grid_map_is_within_its_info_in_ros1():
    registry = Registry(ros1_packages=Path("/nonexistent"))
    name = "grid_map_msgs/msg/GridMap"
    message = {"header": {"stamp": {"sec": 5}, "frame_id": "map"}, "info": {"resolution": 0.5}, "layers": ["height"]}
    to_ros1 = registry.hub_to_ros1(name)
    assert to_ros1.convert is not None
    raw = to_ros1.convert(from_json(registry, name, message))
    # seq, the time, the frame, the resolution
    assert raw[:27] == struct.pack("<IIII3sd", 0, 5, 0, 3, b"map", 0.5)


def test_old_tf_messages_become_tf2_messages():
    registry = Registry()
    tf2 = registry.ros1("tf2_msgs/TFMessage").definition
    conversion = registry.ros1_to_hub("tf/tfMessage", definition=tf2)
    assert conversion.target.name == "tf2_msgs/msg/TFMessage"
    assert registry.hub_to_ros1("tf2_msgs/msg/TFMessage").target.name == "tf2_msgs/TFMessage"


def test_definitions_are_read_on_demand(monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object) -> str:
        pytest.fail("a file was read")

    monkeypatch.setattr("bridge.messages.definitions.sources.read_text", refuse)
    Registry(folders=[DATA])


def test_a_configuration_names_folders_and_mapping_rules(tmp_path: Path):
    package = tmp_path / "new_msgs" / "msg"
    package.mkdir(parents=True)
    (package / "Place.msg").write_text("int32 east\n")
    rules = tmp_path / "rules.yaml"
    rules.write_text("- {ros1_package_name: old_msgs, ros2_package_name: new_msgs}\n")
    types = TypesSection(folders=(tmp_path,), mapping_rules=(rules,))
    registry = Registry.of(types)
    registry.learn_ros1("old_msgs/Place", "int32 east\n")
    assert registry.hub_to_ros1("new_msgs/msg/Place").target.name == "old_msgs/Place"


def test_converters_are_made_once(registry: Registry):
    assert registry.ros1_to_hub("std_msgs/String") is registry.ros1_to_hub("std_msgs/String")
    conversion = registry.ros1_to_hub("std_msgs/String", registry.ros1("std_msgs/String").type_id)
    assert conversion is registry.ros1_to_hub("std_msgs/String", "*")


def test_unknown_type_is_reported_with_its_cure(registry: Registry):
    with pytest.raises(MessageTypeError, match="no definition of the ROS 1 type nobody_msgs/Knows") as caught:
        registry.ros1_to_hub("nobody_msgs/Knows")
    assert "types.folders" in caught.value.cure
    for name in ("nobody", "../../etc/passwd", "a/b/c/d", ""):
        with pytest.raises(MessageTypeError):
            registry.ros1(name)
        with pytest.raises(MessageTypeError):
            registry.ros2(name)


def test_a_header_definition_outranks_the_installed_one():
    registry = Registry()
    installed = registry.ros1("std_msgs/ColorRGBA")
    registry.learn_ros1("std_msgs/ColorRGBA", "float32 r\nfloat32 g\nfloat32 b\n")
    learned = registry.ros1("std_msgs/ColorRGBA")
    assert learned.type_id != installed.type_id
    assert registry.hub_to_ros1("std_msgs/msg/ColorRGBA").target == learned
    assert registry.ros1_to_hub("std_msgs/ColorRGBA", installed.type_id).source == installed


def test_two_definitions_of_one_name_coexist():
    registry = Registry()
    old, new = "int32 a\n", "int32 a\nstring b\n"
    ids = []
    for text in (old, new):
        bare = Registry()
        bare.learn_ros1("my_msgs/Thing", text)
        ids.append(bare.ros1("my_msgs/Thing").type_id)
    first = registry.ros1_to_hub("my_msgs/Thing", ids[0], old)
    second = registry.ros1_to_hub("my_msgs/Thing", ids[1], new)
    assert first.convert is not None
    assert second.convert is not None
    assert first.target.name == second.target.name
    assert first.target.type_id != second.target.type_id
    assert first.convert(b"\1\0\0\0") == b"\0\1\0\0\1\0\0\0"
    assert second.convert(b"\1\0\0\0\1\0\0\0x") == b"\0\1\0\0\1\0\0\0\2\0\0\0x\0"
    # Each hash refers to its own definition, whichever was learned last.
    for conversion, md5 in zip((first, second), ids, strict=True):
        assert registry.hub_to_ros1("my_msgs/msg/Thing", conversion.target.type_id).target.type_id == md5
    with pytest.raises(MessageTypeError, match=r"0+ there but .* here"):
        registry.ros1_to_hub("my_msgs/Thing", "0" * 32)


def test_a_definition_that_does_not_match_its_md5_is_refused():
    with pytest.raises(MessageTypeError, match=r"but f{32} was announced"):
        Registry().ros1_to_hub("my_msgs/Thing", "f" * 32, "int32 a\n")


def test_different_hash_is_reported(registry: Registry):
    with pytest.raises(MessageTypeError, match=r"has the hash RIHS01_0+ there but RIHS01_\w+ here") as caught:
        registry.hub_to_ros1("std_msgs/msg/String", "RIHS01_" + "0" * 64)
    assert "same version of std_msgs" in caught.value.cure


def test_a_definition_from_the_hub_serves_its_hash():
    registry = Registry()
    known = registry.ros2("std_msgs/msg/Int32")
    other = Registry()
    other.learn_ros2("my_msgs/msg/Thing", "int32 data\nstd_msgs/Header header\n" + header_section())
    thing = other.ros2("my_msgs/msg/Thing")
    registry.learn_ros2("my_msgs/msg/Thing", thing.definition)
    conversion = registry.hub_to_ros1("my_msgs/msg/Thing", thing.type_id)
    assert conversion.target.name == "my_msgs/Thing"
    assert "std_msgs/Header header" in conversion.target.definition
    assert conversion.convert is not None
    message = from_json(registry, "my_msgs/msg/Thing", {"data": 5, "header": {"frame_id": "map"}})
    assert conversion.convert(message) == b"\5\0\0\0" + bytes(12) + b"\3\0\0\0map"
    assert registry.ros2("std_msgs/msg/Int32") == known


def test_a_ros1_type_maps_to_the_definition_that_others_use():
    """ROS 1 has no bounds, so its type maps to the hub's bounded definition, whose subscribers then receive it."""
    registry = Registry()
    registry.learn_ros2("my_msgs/msg/Thing", "string<=5 text\n")
    registry.learn_ros1("my_msgs/Thing", "string text\n")
    assert registry.ros1_to_hub("my_msgs/Thing").target == registry.ros2("my_msgs/msg/Thing")
    registry.learn_ros1("my_msgs/Thing", "string text\nint32 more\n")
    assert registry.ros1_to_hub("my_msgs/Thing").target != registry.ros2("my_msgs/msg/Thing")


def test_types_that_exist_only_in_ros1_are_derived():
    registry = Registry()
    registry.learn_ros1(
        "old_pkg/my_thing",
        "Header header\nint32 Value\ntime[] when\nold_pkg/inner__x inner\nbyte BAD=-1\nstring Name=a b\n"
        + header_section(seq=True)
        + SEPARATOR
        + "MSG: old_pkg/inner__x\nfloat32 A_\nduration d\n",
    )
    conversion = registry.ros1_to_hub("old_pkg/my_thing")
    target = conversion.target
    assert target.name == "old_pkg/msg/MyThing"
    definition_lines = target.definition.split("=" * 80)[0].splitlines()
    assert definition_lines == [
        "byte BAD=255",
        'string NAME="a b"',
        "std_msgs/Header header",
        "int32 value",
        "builtin_interfaces/Time[] when",
        "old_pkg/InnerX inner",
    ]
    other = Registry()
    other.learn_ros2(target.name, target.definition)
    assert other.ros2(target.name).type_id == target.type_id
    back = registry.hub_to_ros1(target.name, target.type_id)
    assert back.target == conversion.source
    values = {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "map"},
        "value": 3,
        "when": [{"sec": 4, "nanosec": 5}],
        "inner": {"a": 0.5, "d": {"sec": 6, "nanosec": 7}},
    }
    assert back.convert is not None
    assert conversion.convert is not None
    assert to_json(
        registry, target.name, conversion.convert(back.convert(from_json(registry, target.name, values)))
    ) == (values)


@pytest.mark.skipif(not (GENPY / "move_base_msgs").is_dir(), reason="move_base_msgs is not installed")
def test_all_messages_of_move_base_are_derived(registry: Registry):
    conversion = registry.ros1_to_hub("move_base_msgs/MoveBaseActionGoal")
    assert conversion.target.name == "move_base_msgs/msg/MoveBaseActionGoal"
    files = registry.ros2_package_sources("move_base_msgs")
    assert "geometry_msgs/PoseStamped target_pose" in files["msg/MoveBaseGoal.msg"]
    assert set(files) >= {f"msg/MoveBase{part}.msg" for part in ("Goal", "ActionGoal", "Result", "Feedback", "Action")}
    for path, text in files.items():
        name = f"move_base_msgs/msg/{Path(path).stem}"
        assert registry.ros2(name).definition.startswith(text.rstrip("\n")), name


def test_the_sources_of_ros2_packages_are_found(registry: Registry):
    files = registry.ros2_package_sources("nav2_msgs")
    assert "action/NavigateToPose.action" in files
    assert "msg/Costmap.msg" in files
    assert "srv/LoadMap.srv" in files
    assert "msg/Octomap.msg" in registry.ros2_package_sources("octomap_msgs")
    assert registry.ros2_package_sources("nobody_msgs") == {}


def test_parts_of_actions_are_known(registry: Registry):
    feedback = registry.ros2("nav2_msgs/action/NavigateToPose_FeedbackMessage")
    assert "unique_identifier_msgs/UUID goal_id" in feedback.definition
    with pytest.raises(MessageTypeError, match="part of a service or action"):
        registry.hub_to_ros1("nav2_msgs/action/NavigateToPose_Goal")


def test_wstring_has_no_ros1_type():
    registry = Registry()
    registry.learn_ros2("my_msgs/msg/Wide", "wstring text\n")
    with pytest.raises(MessageTypeError, match="field text is a wstring"):
        registry.hub_to_ros1("my_msgs/msg/Wide")


NO_PAIRS = [
    ("int32 a\nint32 b\n", "int32 a\nint32 c\n", "only the first has b, only the second c"),
    ("int32 a\n", "float32 a\n", r"field a \(int32\) and field a \(float32\): the two types differ"),
    ("int32[3] a\n", "int32[4] a\n", "the arrays differ in length"),
    ("int32[] a\n", "int32 a\n", "one is a sequence, the other a single value"),
    ("geometry_msgs/Point a\n", "geometry_msgs/Point32 a\n", "are not counterparts"),
    ("time a\n", "builtin_interfaces/Duration a\n", "time corresponds to builtin_interfaces/msg/Time only"),
    ("string a\n", "wstring a\n", "ROS 1 has no wstring"),
]


@pytest.mark.parametrize(("ros1", "ros2", "reason"), NO_PAIRS)
def test_types_that_do_not_match_are_reported_with_the_reason(tmp_path: Path, ros1: str, ros2: str, reason: str):
    registry = with_ros2(tmp_path, ros2)
    nested = SEPARATOR + "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n" if "geometry" in ros1 else ""
    with pytest.raises(MessageTypeError, match=reason) as caught:
        registry.ros1_to_hub("my_msgs/Thing", definition=ros1 + nested)
    assert "mapping rule" in caught.value.cure


ONE_SIDED = [
    ("int32 a\nint32 b\n", "int32 a\n", b"\1\0\0\0\2\0\0\0", {"a": 1}),
    ("int32 a\n", "string[2] s ['x', 'yz']\nint32 a\n", b"\1\0\0\0", {"s": ["x", "yz"], "a": 1}),
    ("int32 a\n", "int32 a\nfloat64[3] f\nbool b true\n", b"\1\0\0\0", {"a": 1, "f": [0.0, 0.0, 0.0], "b": True}),
    ("int32 a\n", "geometry_msgs/Pose[2] p\nint32 a\n", b"\1\0\0\0", {"p": [{"w": 1.0}] * 2, "a": 1}),
    ("uint8 a\n", "byte a\nwstring w 'é'\nint16[] n [3, 4]\n", b"\1", {"a": 1, "w": "é", "n": [3, 4]}),
    ("string[] a\nuint8 b\nint32 c\n", "uint8 b\n", b"\1\0\0\0\2\0\0\0xy\7\1\0\0\0", {"b": 7}),
    ("geometry_msgs/Point[2] a\nuint8 b\n", "uint8 b\n", bytes(48) + b"\7", {"b": 7}),
]


@pytest.mark.parametrize(("ros1", "ros2", "message", "expected"), ONE_SIDED)
def test_fields_on_one_side_get_defaults(
    tmp_path: Path, ros1: str, ros2: str, message: bytes, expected: dict[str, object]
):
    registry = with_ros2(tmp_path, ros2)
    nested = SEPARATOR + "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n" if "geometry" in ros1 else ""
    convert = registry.ros1_to_hub("my_msgs/Thing", definition=ros1 + nested).convert
    assert convert is not None
    converted = to_json(registry, "my_msgs/msg/Thing", convert(message))
    if "p" in converted:
        converted["p"] = [{"w": pose["orientation"]["w"]} for pose in converted["p"]]
    assert converted == expected
    back = registry.hub_to_ros1("my_msgs/msg/Thing").convert
    assert back is not None
    assert len(back(convert(message))) > 0


@pytest.mark.parametrize(
    ("ros1", "expected"),
    [
        ("float32 T\nfloat32 t\n", {"t_2": 1.0, "t": 2.0}),
        ("float32 t\nfloat32 T\n", {"t": 1.0, "t_2": 2.0}),
        ("float32 Ab\nfloat32 aB\n", {"ab": 1.0, "ab_2": 2.0}),
        ("float32 t_2\nfloat32 T\nfloat32 t\n", {"t_2": 1.0, "t_3": 2.0, "t": 3.0}),
        ("float32 a_\nfloat32 A\nfloat32 a__\n", {"a": 1.0, "a_2": 2.0, "a_3": 3.0}),
    ],
)
def test_fields_that_differ_only_in_case_are_numbered(ros1: str, expected: dict[str, float]):
    registry = Registry()
    message = struct.pack(f"<{len(expected)}f", *expected.values())
    to_hub = registry.ros1_to_hub("my_msgs/Thing", definition=ros1)
    assert to_hub.convert is not None
    assert to_hub.left_out == ()
    assert to_json(registry, "my_msgs/msg/Thing", to_hub.convert(message)) == expected
    back = registry.hub_to_ros1("my_msgs/msg/Thing").convert
    assert back is not None
    assert back(to_hub.convert(message)) == message


@pytest.mark.parametrize(
    ("ros2", "expected"),
    [
        ("float32 t\n", {"t": 2.0}),  # T is only in ROS 1
        ("float32 t_2\nfloat32 t\n", {"t_2": 1.0, "t": 2.0}),
    ],
)
def test_fields_that_differ_only_in_case_match_those_of_a_ros2_type(
    tmp_path: Path, ros2: str, expected: dict[str, float]
):
    registry = with_ros2(tmp_path, ros2)
    convert = registry.ros1_to_hub("my_msgs/Thing", definition="float32 T\nfloat32 t\n").convert
    assert convert is not None
    assert to_json(registry, "my_msgs/msg/Thing", convert(struct.pack("<2f", 1.0, 2.0))) == expected


def test_lost_fields_of_ros1_are_named(tmp_path: Path):
    registry = with_ros2(tmp_path, "std_msgs/Header header\nuint8 b\n")
    header = SEPARATOR + "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    more = "Header header\nuint8 b\nfloat64 extra\n"
    assert registry.ros1_to_hub("my_msgs/Thing", definition=more + header).left_out == ("my_msgs/Thing.extra",)
    assert registry.ros1_to_hub("std_msgs/Header").left_out == ()
    assert registry.ros1_to_hub("visualization_msgs/Marker").left_out == ()


def test_a_folder_serves_both_worlds(tmp_path: Path):
    """Whichever ROS version's spelling a file has, the type for the other version is derived from it."""
    folder = tmp_path / "defs" / "my_msgs"
    folder.mkdir(parents=True)
    (folder / "Old.msg").write_text("Header header\ntime Stamp\n")
    (folder / "New.msg").write_text("builtin_interfaces/Time stamp\nstring<=5 text\nint32 a 5\n")
    registry = Registry(folders=[tmp_path / "defs"])
    assert "builtin_interfaces/Time stamp" in registry.ros2("my_msgs/msg/Old").definition
    assert registry.ros1("my_msgs/Old").definition.startswith("Header header\ntime Stamp\n")
    assert registry.ros1("my_msgs/New").definition == "time stamp\nstring text\nint32 a\n"
    for name in ("Old", "New"):
        assert registry.ros1_to_hub(f"my_msgs/{name}").target == registry.ros2(f"my_msgs/msg/{name}")


@pytest.mark.parametrize("layout", ["pkg/msg", "pkg", ""])
def test_definitions_are_found_in_each_layout_of_folders(tmp_path: Path, layout: str):
    root = tmp_path / "pkg" if not layout else tmp_path
    folder = root / layout
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "Thing.msg").write_text("int32 a\n")
    registry = Registry(folders=[root])
    assert registry.ros1_to_hub("pkg/Thing").target.name == "pkg/msg/Thing"


def test_definitions_are_found_in_prefixes_of_built_packages(tmp_path: Path):
    folder = tmp_path / "share" / "built_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Thing.idl").write_text("module built_msgs { module msg { struct Thing { int32 a; }; }; };")
    assert Registry(prefixes=[tmp_path]).ros2("built_msgs/msg/Thing").type_id.startswith("RIHS01_")


@pytest.mark.parametrize("kind", ["wchar", "long double"])
def test_a_type_of_idl_that_cannot_be_converted_is_named(tmp_path: Path, kind: str) -> None:
    """Other errors than `MessageTypeError` would end the engine of a side."""
    (tmp_path / "my_msgs").mkdir()
    for name, field in {"Odd": f"{kind} a", "Holder": "Odd odd"}.items():
        text = f"module my_msgs {{ module msg {{ struct {name} {{ {field}; }}; }}; }};"
        (tmp_path / "my_msgs" / f"{name}.idl").write_text(text)
    registry = Registry(folders=[tmp_path])
    for name in ("Odd", "Holder"):
        for use in (registry.ros2, registry.hub_check, registry.hub_to_ros1):
            with pytest.raises(MessageTypeError, match=rf"my_msgs/msg/Odd has a field with the IDL type {kind}"):
                use(f"my_msgs/msg/{name}")


def test_registry_is_thread_safe():
    registry = Registry()
    names = ["std_msgs/String", "nav_msgs/Odometry", "sensor_msgs/LaserScan", "tf2_msgs/TFMessage"] * 4
    finished: list[str] = []

    def ask(name: str) -> None:
        convert = registry.ros1_to_hub(name).convert
        assert convert is not None
        finished.append(name)

    threads = [threading.Thread(target=ask, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(finished) == sorted(names)


def with_ros2(tmp_path: Path, text: str) -> Registry:
    """Return a registry that knows my_msgs/msg/Thing only for ROS 2, from an installation prefix."""
    folder = tmp_path / "share" / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Thing.msg").write_text(text, encoding="utf-8")
    return Registry(prefixes=[tmp_path])


def header_section(*, seq: bool = False) -> str:
    stamp = "uint32 seq\ntime stamp" if seq else "builtin_interfaces/Time stamp"
    text = f"{SEPARATOR}MSG: std_msgs/Header\n{stamp}\nstring frame_id\n"
    if not seq:
        text += f"{SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    return text


EMPTY_MD5 = "d41d8cd98f00b204e9800998ecf8427e"


def test_the_md5_sum_alone_defines_an_empty_type():
    to_hub = Registry().ros1_to_hub("my_robot/ping_me", EMPTY_MD5)
    assert to_hub.convert is not None
    assert (to_hub.target.name, to_hub.convert(b"")) == ("my_robot/msg/PingMe", b"\0\1\0\0\0")
    with pytest.raises(MessageTypeError, match="no definition of the ROS 1 type my_robot/ping_me"):
        Registry().ros1_to_hub("my_robot/ping_me", "*")


def test_the_hash_alone_defines_an_empty_type():
    known = Registry().ros1_to_hub("my_robot/Ping", EMPTY_MD5).target
    assert known.type_id == "RIHS01_eef277e8c43c810b6f9f3378ae352539907bf99f1913b118990412f01114ed5a"  # by rosbags
    back = Registry().hub_to_ros1("my_robot/msg/Ping", known.type_id)
    assert back.convert is not None
    assert (back.target.name, back.target.type_id) == ("my_robot/Ping", EMPTY_MD5)
    assert back.convert(b"\0\1\0\0\0") == b""
    with pytest.raises(MessageTypeError, match="my_robot/msg/Pong"):  # the hash covers the name
        Registry().hub_to_ros1("my_robot/msg/Pong", known.type_id)


def test_empty_version_coexists_with_the_installed_one(tmp_path: Path):
    folder = tmp_path / "my_robot" / "msg"
    folder.mkdir(parents=True)
    (folder / "Ping.msg").write_text("int32 number\n")
    registry = Registry(folders=[tmp_path])
    empty = registry.ros1_schema("my_robot/Ping", EMPTY_MD5)
    assert not empty.root.fields
    assert [field.name for field in registry.schema("my_robot/msg/Ping").root.fields] == ["number"]


def test_fingerprints_alone_define_empty_services():
    service = Registry().service_ros1_to_hub("my_robot/Reset", EMPTY_MD5)
    assert service.hub.name == "my_robot/srv/Reset"
    assert service.request_to_hub is not None
    assert service.request_to_hub(b"") == b"\0\1\0\0\0"
    back = Registry().service_hub_to_ros1("my_robot/srv/Reset", service.hub.type_id)
    assert (back.side.name, back.side.type_id) == ("my_robot/Reset", EMPTY_MD5)
    with pytest.raises(MessageTypeError, match="my_robot/Reset"):
        Registry().service_ros1_to_hub("my_robot/Reset", "0" * 32)


def test_a_nested_empty_type_has_a_line_of_text():
    """Genpy reads a nested type's name up to a line end; without one, it drops the last letter (genpy/dynamic.py)."""
    registry = Registry()
    text = f"Ping ping\nFlag flag\n{SEPARATOR}MSG: my_robot/Ping\n{SEPARATOR}MSG: my_robot/Flag\nbool on\n"
    registry.learn_ros1("my_robot/Both", text)
    written = registry.ros1("my_robot/Both").definition
    assert f"MSG: my_robot/Ping\n\n{SEPARATOR}MSG: my_robot/Flag\n" in written
    again = Registry()
    assert again.learn_ros1("my_robot/Both", written) == registry.ros1("my_robot/Both").type_id

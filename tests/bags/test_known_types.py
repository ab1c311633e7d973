"""Which definition is used to read a bag: the bag's own, or else a known one that the messages fit."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_typestore

from bridge.bags.bag import BagError, Kind
from bridge.bags.conversion import to_hub
from bridge.bags.copy import convert
from bridge.bags.known_types import FOLDERS
from bridge.bags.play.topics import PlayChoice, choose
from bridge.bags.reader import open_bag
from bridge.config.model import Config
from bridge.messages.registry import Registry
from tests.bags.foreign import CDR, TIME, Recorded, foreign_mcap, humble_db3
from tests.bags.stock import rosbag, rosbags
from tests.bags.written import ROS2, START, STRING, value
from tests.peers.ros1.network import needs_ros1

DRIVE, RANGE, SEPARATOR = "my_robot/msg/Drive", "sensor_msgs/msg/Range", "=" * 80
OLD_DRIVE, NEW_DRIVE = "float32 speed\nfloat32 angle\n", "float32 angle\nfloat32 speed\n"
OLD_DATA = CDR + struct.pack("<ff", 1.5, 0.25)
HUMBLE_STORE = get_typestore(Stores.ROS2_HUMBLE)
KINDS: tuple[Kind, ...] = ("mcap", "db3", "bag")
SEVERAL = pytest.mark.parametrize("kind", KINDS)


def humble_range(number: int = 0) -> bytes:
    """Return a Range message of Humble, which has no field ``variance``."""
    types = HUMBLE_STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](number, 6), "laser")
    return bytes(HUMBLE_STORE.serialize_cdr(types[RANGE](header, 1, 0.5, 0.25, 4.0, 1.25), RANGE))


@pytest.fixture
def newer(tmp_path: Path) -> Registry:
    """This machine's types, in which ``Drive`` has its fields in another order."""
    folder = tmp_path / "installed" / "my_robot" / "msg"
    folder.mkdir(parents=True)
    (folder / "Drive.msg").write_text(NEW_DRIVE)
    return Registry(folders=[tmp_path / "installed"])


def convert_bag(source: Path, kind: Kind, registry: Registry, **more: bool) -> Path:
    """Convert a bag into another format, in the same folder."""
    target = source.parent / f"made_{source.stem}{'' if kind == 'db3' else '.' + kind}"
    with open_bag(source) as bag:
        convert(bag, target, kind, registry, **more)
    return target


@SEVERAL
@pytest.mark.parametrize("metadata", [{}, {"topic_type_hash": "RIHS01_" + "ab" * 32}, {"topic_type_hash": "INVALID"}])
def test_a_bags_own_definition_wins(kind: Kind, metadata: dict[str, str], newer: Registry, tmp_path: Path) -> None:
    source = foreign_mcap(tmp_path / "old.mcap", Recorded("/drive", DRIVE, OLD_DRIVE, [OLD_DATA], metadata))
    [(_, _, message)] = rosbags(convert_bag(source, kind, newer))
    assert (message.speed, message.angle) == (1.5, 0.25)


@SEVERAL
def test_nested_types_of_the_bags_definition_win_too(kind: Kind, newer: Registry, tmp_path: Path) -> None:
    text = f"Drive[] drives\n{SEPARATOR}\nMSG: my_robot/Drive\n{OLD_DRIVE}"
    data = CDR + struct.pack("<Iff", 1, 1.5, 0.25)
    source = foreign_mcap(tmp_path / "old.mcap", Recorded("/drives", "my_robot/msg/Drives", text, [data]))
    [(_, _, message)] = rosbags(convert_bag(source, kind, newer))
    assert [(drive.speed, drive.angle) for drive in message.drives] == [(1.5, 0.25)]


@SEVERAL
def test_definitions_of_humble_win(kind: Kind, tmp_path: Path) -> None:
    text, _ = HUMBLE_STORE.generate_msgdef(RANGE, ros_version=2)
    source = foreign_mcap(tmp_path / "range.mcap", Recorded("/range", RANGE, text, [humble_range()]))
    [(_, _, message)] = rosbags(convert_bag(source, kind, Registry()))
    assert (message.header.frame_id, message.range) == ("laser", 1.25)
    assert not hasattr(message, "variance")


@SEVERAL
def test_each_ros1_definition_without_md5_is_read_by_itself(kind: Kind, newer: Registry, tmp_path: Path) -> None:
    data = struct.pack("<ff", 1.5, 0.25)
    source = foreign_mcap(
        tmp_path / "two.mcap", Recorded("/a", "my_robot/Drive", OLD_DRIVE, [data]),
        Recorded("/b", "my_robot/Drive", NEW_DRIVE, [data]), encoding="ros1",
    )  # fmt: skip
    target = convert_bag(source, kind, newer)
    with open_bag(target) as bag:
        types_ = {m.topic.name: (m.topic.definition, m.data.removeprefix(CDR)) for m in bag.messages()}
    if kind == "bag":
        assert types_ == {"/a": (OLD_DRIVE, data), "/b": (NEW_DRIVE, data)}
    else:  # both topics get the installed definition
        swapped = struct.pack("<ff", 0.25, 1.5)
        assert types_ == {"/a": (NEW_DRIVE, swapped), "/b": (NEW_DRIVE, data)}


def test_an_unreadable_definition_is_not_replaced_by_another(newer: Registry, tmp_path: Path) -> None:
    source = foreign_mcap(tmp_path / "odd.mcap", Recorded("/drive", DRIVE, "float32 speed [\n", [OLD_DATA]))
    with pytest.raises(BagError, match=r"/drive has type my_robot/msg/Drive.*cannot read the definition.*line 1"):
        convert_bag(source, "bag", newer)


def test_parts_of_an_action_keep_definition_and_hash(tmp_path: Path) -> None:
    name = "my_robot/action/Go_FeedbackMessage"
    text = (
        f"unique_identifier_msgs/UUID goal_id\nmy_robot/action/Go_Feedback feedback\n{SEPARATOR}\n"
        "MSG: my_robot/action/Go_Feedback\nint32 done\n"
    )
    type_hash = Registry().learn_ros2(name, text)
    # some MCAP writers leave the kind (here "action") out of type names
    stored = text.replace("/action/", "/")
    for number, metadata in enumerate(({"topic_type_hash": type_hash}, {})):
        recorded = Recorded("/go/_action/feedback", name, stored, [], metadata)
        with open_bag(foreign_mcap(tmp_path / f"{number}.mcap", recorded)) as bag:
            form = to_hub(Registry(), bag.topics[0])
        assert form.type_hash == type_hash
        assert form.definition.endswith("MSG: my_robot/action/Go_Feedback\nint32 done\n")


@pytest.fixture
def humble(tmp_path: Path) -> Path:
    text = bytes(ROS2.serialize_cdr(value(ROS2, STRING, 0), STRING))
    return humble_db3(
        tmp_path / "humble.db3", Recorded("/range", RANGE, None, [humble_range(n) for n in range(3)]),
        Recorded("/text", STRING, None, [text]),
    )  # fmt: skip


@SEVERAL
def test_without_a_definition_the_messages_must_fit(kind: Kind, humble: Path) -> None:
    with pytest.raises(
        BagError, match=r"/range has type sensor_msgs/msg/Range.*no complete definition.*do not fit"
    ) as caught:
        convert_bag(humble, kind, Registry())
    assert FOLDERS in str(caught.value)
    target = convert_bag(humble, kind, Registry(), skip_unknown=True)
    assert [topic for topic, *_ in rosbags(target)] == ["/text"]


@SEVERAL
def test_a_folder_with_the_recorded_version_makes_the_topic_readable(kind: Kind, humble: Path, tmp_path: Path) -> None:
    text, _ = HUMBLE_STORE.generate_msgdef(RANGE, ros_version=2)
    folder = tmp_path / "types" / "sensor_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Range.msg").write_text(text.partition(SEPARATOR)[0])
    target = convert_bag(humble, kind, Registry(folders=[tmp_path / "types"]))
    assert [message.range for topic, _, message in rosbags(target) if topic == "/range"] == [1.25] * 3


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("float32 speed\n", [CDR + struct.pack("<ff", 1.5, 0.25)]),  # one field fewer than recorded
        ("float32 speed\nfloat32 angle\nstring name\n", [OLD_DATA]),  # one field more
        ("string<=3 name\n", [CDR + b"\3\0\0\0hi\0", CDR + b"\7\0\0\0longer\0"]),  # the second message does not fit
    ],
)
def test_definitions_that_do_not_fit_are_noticed(text: str, messages: list[bytes], tmp_path: Path) -> None:
    folder = tmp_path / "types" / "my_robot" / "msg"
    folder.mkdir(parents=True)
    (folder / "Drive.msg").write_text(text)
    source = humble_db3(tmp_path / "a.db3", Recorded("/drive", DRIVE, None, messages))
    with pytest.raises(BagError, match=r"/drive.*do not fit.*types\.folders"):
        convert_bag(source, "mcap", Registry(folders=[tmp_path / "types"]))


@pytest.mark.parametrize("metadata", [{}, {"topic_type_hash": "RIHS01_" + "ab" * 32}])
def test_nested_types_that_a_definition_leaves_out_must_fit(metadata: dict[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "types" / "my_robot" / "msg"
    folder.mkdir(parents=True)
    registry = Registry(folders=[tmp_path / "types"])
    data = CDR + struct.pack("<Iff", 1, 1.5, 0.25)
    recorded = Recorded("/drives", "my_robot/msg/Drives", "Drive[] drives\n", [data], metadata)
    source = foreign_mcap(tmp_path / "a.mcap", recorded)
    (folder / "Drive.msg").write_text(f"{OLD_DRIVE}float64 since\n")
    with pytest.raises(BagError, match=r"/drives has type my_robot/msg/Drives.*types\.folders"):
        convert_bag(source, "bag", registry)
    if not metadata:
        (folder / "Drive.msg").write_text(OLD_DRIVE)
        [(_, _, message)] = rosbags(convert_bag(source, "bag", Registry(folders=[tmp_path / "types"])))
        assert [(drive.speed, drive.angle) for drive in message.drives] == [(1.5, 0.25)]


def test_a_hash_that_is_unknown_here_is_not_replaced(tmp_path: Path) -> None:
    type_hash = "RIHS01_" + "ab" * 32
    recorded = Recorded("/range", RANGE, None, [humble_range()], {"topic_type_hash": type_hash})
    source = foreign_mcap(tmp_path / "range.mcap", recorded)
    with open_bag(convert_bag(source, "mcap", Registry())) as bag:
        assert [(topic.type_hash, topic.definition) for topic in bag.topics] == [(type_hash, "")]
    with pytest.raises(BagError, match=rf"has the hash {type_hash} there.*types\.folders"):
        convert_bag(source, "bag", Registry())


def test_topics_that_do_not_fit_are_not_played(humble: Path) -> None:
    with open_bag(humble) as bag:
        chosen, left = choose([bag], Registry(), Config(), PlayChoice(lambda _: True, {}))
        assert [topic.name for topic in chosen[bag]] == ["/text"]
    [range_topic] = left
    assert range_topic.name == "/range"
    assert range_topic.why.endswith(FOLDERS)


def test_without_a_definition_a_bag_of_this_version_is_read(tmp_path: Path) -> None:
    text = bytes(ROS2.serialize_cdr(value(ROS2, STRING, 0), STRING))
    padded = [text, text + b"\0", text + b"\1\2\3"]  # DDS pads with arbitrary bytes
    target = convert_bag(humble_db3(tmp_path / "a.db3", Recorded("/text", STRING, None, padded)), "bag", Registry())
    assert [message.data for *_, message in rosbags(target)] == ["text 0"] * 3


EMPTY_HASH = "RIHS01_eef277e8c43c810b6f9f3378ae352539907bf99f1913b118990412f01114ed5a"
EMPTY_MD5 = "d41d8cd98f00b204e9800998ecf8427e"
PING = "my_robot/msg/Ping"
EMPTY_BAGS = {
    "ROS 1 bag": lambda folder: empty_ros1_bag(folder / "ping.bag"),
    "db3": lambda folder: empty_db3(folder / "ping"),
    "MCAP": lambda folder: foreign_mcap(folder / "ping.mcap", Recorded("/ping", PING, "", [CDR + b"\0"])),
    "MCAP of IDL": lambda folder: foreign_mcap(
        folder / "ping.mcap", Recorded("/ping", PING, "uint8 structure_needs_at_least_one_member\n", [CDR + b"\0"])
    ),
    "MCAP with a hash": lambda folder: foreign_mcap(
        folder / "ping.mcap", Recorded("/ping", PING, "", [CDR + b"\0"], {"topic_type_hash": EMPTY_HASH})
    ),
    "MCAP with only a hash": lambda folder: foreign_mcap(
        folder / "ping.mcap", Recorded("/ping", PING, None, [CDR + b"\0"], {"topic_type_hash": EMPTY_HASH})
    ),
    "MCAP of ROS 1": lambda folder: foreign_mcap(
        folder / "ping.mcap", Recorded("/ping", "my_robot/Ping", "", [b""], {"md5sum": EMPTY_MD5}), encoding="ros1"
    ),
}


def empty_ros1_bag(path: Path) -> Path:
    from rosbags.rosbag1 import Writer

    with Writer(path) as writer:
        ping = writer.add_connection("/ping", PING, msgdef="", md5sum=EMPTY_MD5, callerid="/robot", latching=0)
        writer.write(ping, START, b"")
    return path


def empty_db3(path: Path) -> Path:
    from rosbags.rosbag2 import Writer

    with Writer(path, version=9) as writer:
        ping = writer.add_connection("/ping", PING, msgdef="", rihs01=EMPTY_HASH)
        writer.write(ping, START, CDR + b"\0")
    return path


@SEVERAL
@pytest.mark.parametrize("source", EMPTY_BAGS)
def test_an_own_empty_type_is_known(kind: Kind, source: str, tmp_path: Path) -> None:
    target = convert_bag(EMPTY_BAGS[source](tmp_path), kind, Registry())
    assert [(topic, type_name) for topic, type_name, _ in rosbags(target)] == [("/ping", PING)]
    with open_bag(target) as bag:
        assert [topic.type_hash for topic in bag.topics] == [EMPTY_MD5 if kind == "bag" else EMPTY_HASH]
        assert bag.topics[0].definition


@needs_ros1
def test_rosbag_reads_types_that_nest_an_empty_type(tmp_path: Path) -> None:
    text = f"Ping ping\nFlag flag\n{SEPARATOR}\nMSG: my_robot/Ping\n{SEPARATOR}\nMSG: my_robot/Flag\nbool lit\n"
    source = foreign_mcap(
        tmp_path / "a.mcap", Recorded("/ping", PING, "", [CDR + b"\0"]),
        Recorded("/both", "my_robot/msg/Both", text, [CDR + b"\0\1"]),
    )  # fmt: skip
    assert rosbag([convert_bag(source, "bag", Registry())]) == [
        [("/ping", "my_robot/Ping", None), ("/both", "my_robot/Both", {"ping": None, "flag": {"lit": True}})]
    ]


def test_an_empty_text_with_another_hash_is_not_a_definition(tmp_path: Path) -> None:
    known = f"RIHS01_{ROS2.hash_rihs01(STRING).removeprefix('RIHS01_')}"
    for number, recorded in enumerate((known, "INVALID")):
        source = Recorded("/text", STRING, "", [CDR + b"\3\0\0\0hi\0"], {"topic_type_hash": recorded})
        with open_bag(foreign_mcap(tmp_path / f"{number}.mcap", source)) as bag:
            assert bag.topics[0].definition == ""
            [message] = bag.messages()
            convert(bag, tmp_path / f"{number}.bag", "bag", Registry())
        assert message.time_ns == TIME
        assert [m.data for *_, m in rosbags(tmp_path / f"{number}.bag")] == ["hi"]

"""Each conversion of each kind of type, decoded with the stock readers, as the table of docs/operate/bags.md shows."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Writer as Writer2

from bridge.bags.bag import BagError
from bridge.bags.copy import convert
from bridge.bags.mcap_writer import ChannelInfo, McapWriter
from bridge.bags.reader import open_bag
from bridge.bags.writers import kind_of
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from tests.bags.stock import READERS, Ros1Message, member, write_ros1
from tests.bags.written import START

PAGE = (Path(__file__).parents[2] / "docs" / "operate" / "bags.md").read_text(encoding="utf-8")
TARGETS = (".mcap", ".db3", ".bag")
GOAL = {"stamp": {"secs": 3}, "id": "one"}
UUID = {"uuid": [7] * 16}


@dataclass(frozen=True)
class Kind:
    """A kind of type, with a message in each ROS version.

    Attributes:
        ros2, ros1: topic, type and values; None if that ROS version does not have the type.
        member: a member of the message, with its value.
        in_ros1: the same in ROS 1, if its name or value differs there.
    """

    ros2: tuple[str, str, Any]
    ros1: tuple[str, str, Any] | None
    member: tuple[str, Any]
    in_ros1: tuple[str, Any] | None = None


_NAVIGATE, _MOVE = "nav2_msgs/action/NavigateToPose", "move_base_msgs/MoveBase"
_ACTION = "/navigate_to_pose/_action"
_X = {"pose": {"position": {"x": 1.5}}}
_STATUS = {"goal_id": GOAL, "status": 1, "text": "driving"}
KINDS = {
    "topic message": Kind(
        ("/pose", "geometry_msgs/msg/PoseStamped", _X), ("/pose", "geometry_msgs/PoseStamped", _X),
        ("pose.position.x", 1.5),
    ),
    "own type": Kind(
        ("/own", "my_msgs/msg/Own", {"part": {"n": 4}}), ("/own", "my_msgs/Own", {"part": {"n": 4}}), ("part.n", 4),
    ),
    "service event": Kind(
        ("/ask/_service_event", "my_robot/srv/Ask_Event", {"info": {"event_type": 1}, "request": [{"a": 5}]}), None,
        ("request.0.a", 5),
    ),
    "action goal": Kind(
        (f"{_ACTION}/send_goal/_service_event", f"{_NAVIGATE}_SendGoal_Event", {"request": [{"goal": {"pose": _X}}]}),
        ("/move_base/goal", f"{_MOVE}ActionGoal", {"goal_id": GOAL, "goal": {"target_pose": _X}}),
        ("request.0.goal.pose.pose.position.x", 1.5), ("goal.target_pose.pose.position.x", 1.5),
    ),
    "action feedback": Kind(
        (f"{_ACTION}/feedback", f"{_NAVIGATE}_FeedbackMessage", {"goal_id": UUID, "feedback": {"current_pose": _X}}),
        ("/move_base/feedback", f"{_MOVE}ActionFeedback", {"status": _STATUS, "feedback": {"base_position": _X}}),
        ("feedback.current_pose.pose.position.x", 1.5), ("feedback.base_position.pose.position.x", 1.5),
    ),
    "action status": Kind(
        (f"{_ACTION}/status", "action_msgs/msg/GoalStatusArray", {"status_list": [{"status": 5}]}),
        ("/move_base/status", "actionlib_msgs/GoalStatusArray", {"status_list": [{**_STATUS, "status": 2}]}),
        ("status_list.0.status", 5), ("status_list.0.status", 2),
    ),
    "action result": Kind(
        (f"{_ACTION}/get_result/_service_event", f"{_NAVIGATE}_GetResult_Event", {"response": [{"status": 4}]}),
        ("/move_base/result", f"{_MOVE}ActionResult", {"status": {**_STATUS, "status": 3}}),
        ("response.0.status", 4), ("status.status", 3),
    ),
}  # fmt: skip
OWN = f"Part part\nstring[2] names\n{'=' * 80}\nMSG: my_msgs/Part\nbyte FULL=7\nchar n\n"
ASK = "int32 a\n---\nint32 b\n"


@pytest.fixture(scope="module")
def registry() -> Registry:
    """Return a registry with the types of the sources; each conversion uses a new registry."""
    built = Registry()
    built.learn_ros1("my_msgs/Own", OWN)
    built.learn_ros2("my_msgs/msg/Own", OWN)
    built.learn_ros2("my_robot/srv/Ask", ASK)
    return built


def _ros2(registry: Registry, kind: Kind) -> tuple[str, str, str, str, bytes]:
    """Return topic, type, hash, full definition and CDR of a kind's message."""
    topic, type_name, values = kind.ros2
    known = registry.ros2(type_name)
    return topic, type_name, known.type_id, known.definition, from_json(registry, type_name, values)


def _mcap2(registry: Registry, files: dict[Path, Kind]) -> None:
    for path, kind in files.items():
        topic, type_name, type_hash, definition, data = _ros2(registry, kind)
        with path.open("wb", buffering=0) as stream:
            writer = McapWriter(stream)
            writer.write(writer.channel(ChannelInfo(topic, type_name, type_hash, definition)), START, START, data)
            writer.finish()


def _db3(registry: Registry, files: dict[Path, Kind]) -> None:
    for path, kind in files.items():
        topic, type_name, type_hash, definition, data = _ros2(registry, kind)
        with Writer2(path, version=9) as writer:
            writer.write(writer.add_connection(topic, type_name, msgdef=definition, rihs01=type_hash), START, data)


def _bag(registry: Registry, files: dict[Path, Kind]) -> None:
    built: dict[Path, list[Ros1Message]] = {}
    for path, kind in files.items():
        assert kind.ros1 is not None
        topic, type_name, values = kind.ros1
        built[path] = [(topic, type_name, registry.ros1(type_name).definition, values)]
    write_ros1(built)


def _mcap1(registry: Registry, files: dict[Path, Kind]) -> None:
    """Write MCAP of profile ``ros1``, as ``mcap convert`` does."""
    _bag(registry, {path.with_suffix(".bag"): kind for path, kind in files.items()})
    for path in files:
        writer = Writer(stream := io.BytesIO())
        writer.start("ros1", "test")
        with Reader1(path.with_suffix(".bag")) as reader:
            for connection, time, data in reader.messages():
                name = connection.msgtype.replace("/msg/", "/")
                schema = writer.register_schema(name, "ros1msg", connection.msgdef.data.encode())
                channel = writer.register_channel(connection.topic, "ros1", schema, {"md5sum": connection.digest})
                writer.add_message(channel, time, bytes(data), time)
        writer.finish()
        path.write_bytes(stream.getvalue())


SOURCES = {
    "ROS 2": {".mcap": _mcap2, "": _db3},
    "ROS 1": {".bag": _bag, ".mcap": _mcap1},
}
"""Functions that write a file for each kind, by the file's extension."""

ROWS = [(kind, world) for kind, has in KINDS.items() for world in SOURCES if world == "ROS 2" or has.ros1]


def readers_of(sources: dict[Path, Kind], ending: str) -> list[str]:
    """Convert files, and return for each the readers that decode its message, or "error"."""
    done = [(source.with_name(f"new-{source.stem}{ending}"), kind) for source, kind in sources.items()]
    converted = [_converts(source, target) for source, (target, _) in zip(sources, done, strict=True)]
    files = [(target, kind) for (target, kind), good in zip(done, converted, strict=True) if good]
    decoded: dict[Path, list[str]] = {target: [] for target, _ in files}
    for name, read in READERS[ending].items():
        for (target, kind), results in zip(files, read([target for target, _ in files]), strict=True):
            path, value = kind.in_ros1 or kind.member if _is_ros1(target, sources) else kind.member
            if not isinstance(results, str) and [member(message, path) for *_, message in results] == [value]:
                decoded[target].append(name)
    return [", ".join(decoded[target]) if target in decoded else "error" for target, _ in done]


def _is_ros1(target: Path, sources: dict[Path, Kind]) -> bool:
    return target.suffix == ".bag" or all(source.name.startswith("ROS 1") for source in sources)


def _converts(source: Path, target: Path) -> bool:
    with open_bag(source) as opened:
        try:
            done = convert(opened, target, kind_of(target), Registry())
        except BagError as err:
            return "--skip-unknown" not in str(err) or target.exists()
    assert (done.messages, done.unknown, done.refused) == (1, {}, {})
    return True


def cells_of(kind: str, world: str) -> list[str]:
    """Return the cells of a row of the page's table."""
    row = re.search(rf"^\| {kind} \| {world}[ ,].*?\| (.*) \|$", PAGE, re.MULTILINE)
    assert row is not None, f"no row of {kind} in {world}"
    return [cell.strip() for cell in row[1].split("|")]


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize(
    ("world", "ending"), [(world, ending) for world, endings in SOURCES.items() for ending in endings]
)
def test_the_table_of_conversions_is_correct(
    world: str, ending: str, target: str, registry: Registry, tmp_path: Path
) -> None:
    kinds = [kind for kind, of in ROWS if of == world]
    sources = {tmp_path / f"{world} {kind}{ending}": KINDS[kind] for kind in kinds}
    SOURCES[world][ending](registry, sources)
    results = dict(zip(kinds, readers_of(sources, target), strict=True))
    assert results == {kind: cells_of(kind, world)[TARGETS.index(target)] for kind in kinds}


def test_the_table_has_no_other_rows() -> None:
    assert sorted(re.findall(r"^\| ([a-z ]+) \| (ROS [12])[ ,]", PAGE, re.MULTILINE)) == sorted(ROWS)

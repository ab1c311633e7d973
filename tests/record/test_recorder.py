"""Recorders write messages as received, latched ones at the start of each file, and count what they cannot write."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from bridge.bags.mcap_writer import McapWriter
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, Durability, Qos
from bridge.record import file as record_file
from bridge.record import places as record_places
from bridge.record import recorder
from bridge.record import series as record_series
from bridge.record.arrivals import ArrivalQueue, RecordedMessage, TopicCounts
from bridge.record.places import PREFIX, BagFolder, Files, KeptFolder
from bridge.record.ring import Ring
from bridge.record.section import RecordSection
from tests.peers.hub.quick import QuickHub
from tests.peers.hub.recorded_robot import Robot, await_topics, await_written, read, recording
from tests.support.wait import until

PARTS = {
    "/go/_action/feedback": "nav2_msgs/action/NavigateToPose_FeedbackMessage",
    "/go/_action/send_goal/_service_event": "nav2_msgs/action/NavigateToPose_SendGoal_Event",
    "/lamp/_service_event": "std_srvs/srv/SetBool_Event",
}


@pytest.fixture(scope="module")
def hubs() -> Iterator[QuickHub]:
    hub = QuickHub()
    yield hub
    hub.stop_router()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_series, "FLUSH_SECONDS", 0.05)


@pytest.fixture
def robot(hubs: QuickHub) -> Iterator[Robot]:
    with Hub.open(hubs.settings("robot")) as hub:
        yield Robot(hub)


def test_messages_are_recorded_unchanged(hubs: QuickHub, robot: Robot, tmp_path: Path) -> None:
    robot.hub.set_origin(Origin("yarp", "here", "robot2"))
    chat, other = robot.publisher("/said"), robot.publisher("/camera/other")
    with recording(hubs, tmp_path, Files(tmp_path / "one", split=False), exclude=["^/camera"]) as recorded:
        path = recorded.recorder.begin()
        until(chat.matched, "the topic is subscribed")
        chat.put(robot.text("one"), 1_000)
        chat.put(robot.text("two"), 2_000)
        other.put(robot.text("not this"))
        status = await_written(recorded, 2)
    assert path == tmp_path / "one.mcap"
    contents = read(path)
    assert contents.whole
    assert [(m.sequence, m.publish_time, m.data) for m in contents.messages] == [
        (1, 1_000, robot.text("one")), (2, 2_000, robot.text("two")),
    ]  # fmt: skip
    assert set(contents.channels) == {"/said"}
    metadata = contents.channels["/said"][0].metadata
    assert (metadata["side"], metadata["origin"], metadata["daemon"]) == ("yarp", "here", "robot2")
    assert contents.metadata["midspan"]["daemon"] == "robot1"
    assert (status.file, status.dropped) == (str(path), {})


def test_each_file_of_a_split_starts_with_latched_messages(hubs: QuickHub, robot: Robot, tmp_path: Path) -> None:
    maps, closed = robot.publisher("/map", LATCHED), robot.publisher("/gone", LATCHED)
    history = robot.publisher("/history", Qos(durability=Durability.TRANSIENT_LOCAL, depth=2))
    chat = robot.publisher("/said")
    maps.put(robot.text("old map"))
    maps.put(robot.text("map"))
    closed.put(robot.text("gone"))
    for number in range(3):
        history.put(robot.text(f"h{number}"))
    with recording(hubs, tmp_path, BagFolder(tmp_path / "run")) as recorded:
        recorded.recorder.begin()
        until(chat.matched, "the topic is subscribed")
        chat.put(robot.text("first"))
        await_written(recorded, 5)
        closed.close()
        until(
            lambda: not recorded.recorder.topics.refresh().keys() & {closed_topic_key(recorded)}, "the topic is removed"
        )
        first = recorded.recorder.split()
        chat.put(robot.text("second"))
        await_written(recorded, 6)
    assert first is not None
    first_file, second_file = read(first), read(tmp_path / "run" / "run_1.mcap")
    assert first_file.texts("/map") == second_file.texts("/map") == ["map"]
    assert first_file.texts("/history") == second_file.texts("/history") == ["h1", "h2"]
    assert (first_file.texts("/gone"), second_file.texts("/gone")) == (["gone"], [])
    assert second_file.texts("/said") == ["second"]
    assert [m.topic for m in second_file.messages][-1] == "/said"
    with Reader(tmp_path / "run") as bag:  # read through the folder's metadata
        assert bag.message_count == len(first_file.messages) + len(second_file.messages)
    with AnyReader([tmp_path / "run"]) as any_bag:
        texts = [any_bag.deserialize(raw, c.msgtype) for c, _, raw in any_bag.messages() if c.topic == "/said"]
    assert [text.data for text in texts] == ["first", "second"]  # type: ignore[attr-defined]


def test_rosbags_opens_a_folder_with_the_parts_of_actions_and_services(
    hubs: QuickHub, robot: Robot, tmp_path: Path
) -> None:
    """The reader computes the hash of each definition, and refuses the folder if one differs from the metadata's."""
    ends = {type_name: robot.publisher(topic, LATCHED, type_name) for topic, type_name in PARTS.items()}
    for type_name, end in ends.items():
        end.put(robot.message(type_name, {}))
    with recording(hubs, tmp_path, BagFolder(tmp_path / "run")) as recorded:
        recorded.recorder.begin()
        await_written(recorded, len(PARTS))
    with AnyReader([tmp_path / "run"]) as bag:
        types = {c.topic: type(bag.deserialize(raw, c.msgtype)).__name__ for c, _, raw in bag.messages()}
    assert types == {topic: type_name.replace("/", "__") for topic, type_name in PARTS.items()}


def test_a_folders_metadata_has_the_qos_of_all_publishers(hubs: QuickHub, robot: Robot, tmp_path: Path) -> None:
    with Hub.open(hubs.settings("yarp_robot")) as hub:
        hub.set_origin(Origin("yarp", "here", "robot2"))
        ends = [robot.publisher("/said"), Robot(hub).publisher("/said", LATCHED)]
        with recording(hubs, tmp_path, BagFolder(tmp_path / "run")) as recorded:
            recorded.recorder.begin()
            until(lambda: all(end.matched() for end in ends), "both publishers have a subscriber")
            for end in ends:
                end.put(robot.text("hi"))
            await_written(recorded, 2)
    status = yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    (topic,) = status["topics_with_message_count"]
    offered = topic["topic_metadata"]["offered_qos_profiles"]
    assert topic["message_count"] == 2
    assert sorted(qos["durability"] for qos in offered) == ["transient_local", "volatile"]


def closed_topic_key(recorded: Any) -> Any:
    return next(end.key for end in recorded.recorder.topics.subscribed() if end.key.topic == "/gone")


def test_a_pause_unsubscribes_and_a_start_continues_in_another_file(
    hubs: QuickHub, robot: Robot, tmp_path: Path
) -> None:
    chat = robot.publisher("/said")
    with recording(hubs, tmp_path, Files(tmp_path / "one", split=False)) as recorded:
        recorded.recorder.begin()
        until(chat.matched, "the topic is subscribed")
        chat.put(robot.text("before"))
        await_written(recorded, 1)
        assert recorded.recorder.pause() == tmp_path / "one.mcap"
        until(lambda: not chat.matched(), "the topic is unsubscribed")
        chat.put(robot.text("meanwhile"))
        assert recorded.recorder.begin() == tmp_path / "one_1.mcap"
        until(chat.matched, "the recorder subscribes again")
        chat.put(robot.text("after"))
        await_written(recorded, 2)
    assert read(tmp_path / "one.mcap").texts("/said") == ["before"]
    assert read(tmp_path / "one_1.mcap").texts("/said") == ["after"]


def test_a_trigger_saves_the_rings_last_moments(hubs: QuickHub, robot: Robot, tmp_path: Path) -> None:
    section = RecordSection.model_validate({"ring": {"seconds": 60.0}})
    ring = Ring(KeptFolder(tmp_path, section.keep), section.ring)
    chat, latched = robot.publisher("/said"), robot.publisher("/map", LATCHED)
    bumper = robot.publisher("/bumper")
    latched.put(robot.text("map"))
    section = RecordSection.model_validate({"ring": {"seconds": 60.0}, "trigger": {"topics": ["/bumper"]}})
    with recording(hubs, tmp_path, ring, ring={"seconds": 60.0}) as recorded:
        recorded.add_triggers(section)
        recorded.recorder.begin()
        until(chat.matched, "the topic is subscribed")
        await_topics(recorded, 3)
        chat.put(robot.text("before it"))
        await_written(recorded, 2)
        assert not list(tmp_path.glob(f"{PREFIX}*"))
        until(lambda: len(robot.hub.graph.subscriptions("/bumper")) >= 2, "the trigger is subscribed")
        bumper.put(robot.text("bump"))
        folder = until(lambda: next(iter(tmp_path.glob(f"{PREFIX}*/metadata.yaml")), None), "the ring is kept").parent
    files = sorted(folder.glob("*.mcap"))
    contents = [read(file) for file in files]
    assert contents[0].texts("/map") == ["map"]
    assert "before it" in [text for part in contents for text in part.texts("/said")]
    assert contents[-1].metadata["midspan.end"]["trigger"] == "a message on /bumper"
    with Reader(folder) as bag:
        assert {c.topic for c in bag.connections} >= {"/said", "/map"}
    assert not (tmp_path / ".ring").exists()


def test_a_trigger_saves_the_messages_that_wait_to_be_written(
    hubs: QuickHub, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = RecordSection.model_validate({"ring": {"seconds": 60.0}})
    ring = Ring(KeptFolder(tmp_path, section.keep), section.ring)
    chat = robot.publisher("/said")
    writes, disk_works = threading.Event(), threading.Event()
    write = record_series.FileSeries.write

    def write_slowly(series: record_series.FileSeries, arrival: RecordedMessage) -> None:
        writes.set()
        disk_works.wait(20)
        write(series, arrival)

    with recording(hubs, tmp_path, ring, ring={"seconds": 60.0}) as recorded:
        recorded.recorder.begin()
        until(chat.matched, "the topic is subscribed")
        monkeypatch.setattr(record_series.FileSeries, "write", write_slowly)
        chat.put(robot.text("first"))
        until(writes.is_set, "the first message is being written")
        chat.put(robot.text("second"))
        until(lambda: recorded.recorder._queue._waiting, "the second message waits")
        saved = recorded.recorder.trigger("a bump")
        disk_works.set()
        folder = saved.result(20)
    assert folder is not None
    assert [text for file in sorted(folder.glob("*.mcap")) for text in read(file).texts("/said")] == ["first", "second"]


def test_a_ring_deletes_older_files(hubs: QuickHub, robot: Robot, tmp_path: Path) -> None:
    section = RecordSection.model_validate({"ring": {"seconds": 0.2}})
    ring = Ring(KeptFolder(tmp_path, section.keep), section.ring)
    chat = robot.publisher("/said")
    with recording(hubs, tmp_path, ring, ring={"seconds": 0.2}) as recorded:
        recorded.recorder.begin()
        until(chat.matched, "the topic is subscribed")
        chat.put(robot.text("old"))
        await_written(recorded, 1)
        recorded.recorder.split()
        until(lambda: not list((tmp_path / ".ring").glob("*.mcap")), "the ring file is deleted")
        assert recorded.recorder.trigger("nothing").result(10) is None


def test_the_ring_of_a_killed_run_is_kept(tmp_path: Path) -> None:
    section = RecordSection.model_validate({"ring": {"seconds": 5.0}})
    (tmp_path / ".ring").mkdir()
    for name in ("1.mcap", "2.mcap"):
        (tmp_path / ".ring" / name).write_text(name)
    ring = Ring(KeptFolder(tmp_path, section.keep), section.ring)
    assert ring.next().parent == tmp_path / ".ring"
    (folder,) = tmp_path.glob(f"{PREFIX}*")
    assert {file.name: file.read_text() for file in folder.iterdir()} == {"1.mcap": "1.mcap", "2.mcap": "2.mcap"}
    assert not list((tmp_path / ".ring").iterdir())


def test_two_recorders_do_not_share_the_folder_of_a_ring(tmp_path: Path) -> None:
    section = RecordSection.model_validate({"ring": {"seconds": 5.0}})
    first, second = (Ring(KeptFolder(tmp_path, section.keep), section.ring) for _ in range(2))
    path = first.next()
    path.touch()
    with pytest.raises(OSError, match="another recorder has its ring in this folder"):
        second.next()
    assert path.exists(), "the second recorder moved it away"
    path.unlink()
    first.discard()
    assert second.next().parent == tmp_path / ".ring"
    second.discard()
    assert not list(tmp_path.iterdir())


def test_topics_that_are_not_bridged_are_requested_from_their_worker(hubs: QuickHub, tmp_path: Path) -> None:
    requests: list[str] = []
    decided = [("/arm/home", "private", "in"), ("/arm/out", "bridged", "in"), ("/leg/home", "denied", "in")]
    with Hub.open(hubs.settings("yarp_worker", worker="yarp")) as hub:
        hub.set_origin(Origin("yarp", "here", "robot1"))
        robot = Robot(hub)
        hub.serve("explain", lambda _: [{"topic": t, "decision": d, "direction": w} for t, d, w in decided])
        hub.serve("tap", lambda what: requests.append(what["topic"]))
        shown = robot.publisher("/_midspan/yarp/arm/home", LATCHED)
        shown.put(robot.text("at home"))
        unasked = robot.publisher("/_midspan/yarp/other", LATCHED)
        unasked.put(robot.text("of another"))
        section = {"topics": ["/arm/**"], "sides": ["yarp"]}
        with recording(hubs, tmp_path, Files(tmp_path / "one", split=False), **section) as recorded:
            recorded.recorder.begin()
            await_written(recorded, 1)
            until(lambda: requests, "the topic is requested")
    assert set(requests) == {"/arm/home"}
    contents = read(tmp_path / "one.mcap")
    assert contents.texts("/arm/home") == ["at home"]
    assert set(contents.channels) == {"/arm/home"}


def test_a_folder_that_cannot_be_created_is_reported_and_retried(
    hubs: QuickHub,
    robot: Robot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(record_series, "RETRY_SECONDS", 0.1)
    place = tmp_path / "place"
    place.write_text("a file with the name of the folder")
    chat = robot.publisher("/said")
    keep = RecordSection().keep
    with recording(hubs, tmp_path, KeptFolder(place, keep)) as recorded:
        with pytest.raises(OSError, match=r"exists|directory"):
            recorded.recorder.begin()
        assert recorded.recorder.status().state == "blocked"
        assert "it continues in a new file as soon as one can be written" in caplog.text
        place.unlink()
        until(lambda: not recorded.recorder.status().error, "the recorder continues")
        until(chat.matched, "the topic is subscribed")
        chat.put(robot.text("after"))
        status = await_written(recorded, 1)
    assert read(Path(status.file)).texts("/said") == ["after"]


def test_a_command_that_waits_for_a_slow_disk_is_reported(
    hubs: QuickHub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    with recording(hubs, tmp_path, Files(tmp_path / "one", split=False)) as recorded:
        recorded.recorder._post(lambda: go_on.wait(40))
        try:
            with monkeypatch.context() as patched:  # only here, since the limit also ends the wait for the thread
                patched.setattr(recorder, "_COMMAND_SECONDS", 0.2)
                with pytest.raises(TimeoutError, match=r"has not answered for 0\.2 s, and does this later"):
                    recorded.recorder.begin()
        finally:
            go_on.set()
        until(lambda: (tmp_path / "one.mcap").exists(), "the file is opened later")


def test_a_file_that_cannot_be_written_is_named_and_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(McapWriter, "metadata", full)
    with pytest.raises(OSError, match=r"No space left.*one\.mcap"):
        record_file.RecordFile(tmp_path / "one.mcap", RecordSection().compression, {})
    assert not list(tmp_path.iterdir())


def simulated_room(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the bytes that are free on the disk, in a list that the test changes."""
    free = [100 << 20]
    monkeypatch.setattr(record_file, "room", lambda _: free[0])
    monkeypatch.setattr(record_series, "room", lambda _: free[0])
    monkeypatch.setattr(record_series, "RETRY_SECONDS", 0.1)
    return free


def test_a_full_disk_stops_recording_until_space_is_free(
    hubs: QuickHub,
    robot: Robot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    free = simulated_room(monkeypatch)
    chat = robot.publisher("/said")
    with recording(hubs, tmp_path, Files(tmp_path / "one", split=False)) as recorded:
        recorded.recorder.begin()
        until(chat.matched, "the topic is subscribed")
        chat.put(robot.text("before"))
        await_written(recorded, 1)
        free[0] = 1 << 20
        chat.put(robot.text("last"))
        until(lambda: recorded.recorder.status().error, "the recorder stops")
        status = recorded.recorder.status()
        assert status.state == "blocked"
        assert "only 1 MB are free" in status.error
        until(lambda: "it continues in a new file when there is space" in caplog.text, "the error is logged")
        until(lambda: read(tmp_path / "one.mcap").whole, "the file is closed")
        assert read(tmp_path / "one.mcap").texts("/said") == ["before", "last"]
        chat.put(robot.text("lost"))
        until(lambda: recorded.recorder.status().dropped.get("disk") == 1, "the dropped message is counted")
        free[0] = 100 << 20
        until(lambda: not recorded.recorder.status().error, "the recorder continues")
        chat.put(robot.text("after"))
        status = await_written(recorded, 3)
    assert status.dropped == {"disk": 1}
    assert Path(status.file).name == "one_1.mcap"
    assert read(Path(status.file)).texts("/said") == ["after"]


def test_latched_message_that_arrives_while_the_disk_is_full_begins_the_next_file(
    hubs: QuickHub, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = simulated_room(monkeypatch)
    state = robot.publisher("/state", LATCHED)
    with recording(hubs, tmp_path, Files(tmp_path / "one", split=False)) as recorded:
        recorded.recorder.begin()
        until(state.matched, "the topic is subscribed")
        state.put(robot.text("before"))
        await_written(recorded, 1)
        free[0] = 1 << 20
        state.put(robot.text("last"))
        until(lambda: recorded.recorder.status().error, "the recorder stops")
        state.put(robot.text("current"))
        until(lambda: recorded.recorder.status().dropped.get("disk") == 1, "the message is dropped")
        free[0] = 100 << 20
        until(lambda: not recorded.recorder.status().error, "the recorder continues")
    assert read(tmp_path / "one_1.mcap").texts("/state") == ["current"]


@pytest.mark.parametrize("seconds", [-40.0, -3600.0, 600.0])
def test_new_file_begins_when_the_clock_is_set(
    hubs: QuickHub, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seconds: float
) -> None:
    real, shift = time.time_ns, 0
    monkeypatch.setattr(time, "time_ns", lambda: real() + shift)
    chat, state = robot.publisher("/said"), robot.publisher("/state", LATCHED)
    state.put(robot.text("on"))
    with recording(hubs, tmp_path, Files(tmp_path / "one", split=False)) as recorded:
        recorded.recorder.begin()
        await_topics(recorded, 2)
        await_written(recorded, 1)
        before = real()
        for number in range(3):
            shift += 50_000_000  # too small for a jump
            chat.put(robot.text(f"before {number}"))
            await_written(recorded, 2 + number)
        shift += round(seconds * 1e9)
        for number in range(3):
            chat.put(robot.text(f"after {number}"))
        await_written(recorded, 7)
    first, second = (read(tmp_path / f"one{end}.mcap") for end in ("", "_1"))
    assert first.texts("/said") == [f"before {number}" for number in range(3)]
    assert second.texts("/said") == [f"after {number}" for number in range(3)]
    assert second.texts("/state") == ["on"], "each file starts with the latched messages"
    assert not (tmp_path / "one_2.mcap").exists()
    assert all((m.log_time - before) * seconds > 0 for m in second.messages), "the times of the set clock"


def test_a_full_queue_drops_and_counts_messages_large_ones_first() -> None:
    queue = ArrivalQueue(1 << 20)
    images, small = (TopicCounts(name, None) for name in ("/image", "/small"))  # type: ignore[arg-type]

    def put(counts: TopicCounts, size: int) -> None:
        queue.put(RecordedMessage(counts, b"", None, 1, 1, 1, 0, bytes(size)))

    for _ in range(20):
        put(images, 100_000)
    for _ in range(100):
        put(small, 100)
    assert images.dropped["queue"] == 20 - 9
    assert not small.dropped
    waiting = queue.pop_all(0.0)
    assert len(waiting) == 109
    for arrival in waiting:
        queue.release(arrival)
    put(images, 100_000)
    assert len(queue.pop_all(0.0)) == 1


def test_a_folder_is_created_once_even_if_its_first_file_fails_repeatedly(tmp_path: Path) -> None:
    place = BagFolder(tmp_path / "run")
    assert {place.next() for _ in range(3)} == {tmp_path / "run" / "run_0.mcap"}
    with pytest.raises(FileExistsError):
        BagFolder(tmp_path / "run").next()


def test_the_oldest_recordings_are_deleted_beyond_the_limits(tmp_path: Path) -> None:
    keep = RecordSection.model_validate({"keep": {"size": 1, "files": 3}}).keep
    folder = KeptFolder(tmp_path, keep)
    (tmp_path / "mine.mcap").write_bytes(bytes(5 << 20))
    for number in range(5):
        (tmp_path / f"{PREFIX}2020_0{number}.mcap").write_bytes(bytes(10))
    (tmp_path / f"{PREFIX}2021").mkdir()
    (tmp_path / f"{PREFIX}2021" / "a.mcap").write_bytes(bytes(2 << 20))
    folder.prune()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [f"{PREFIX}2021", "mine.mcap"]


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_ring_does_not_depend_on_the_system_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hours: int
) -> None:
    section = RecordSection.model_validate({"ring": {"seconds": 30.0}})
    ring = Ring(KeptFolder(tmp_path, section.keep), section.ring)
    closed = []
    for number in range(3):
        now = time.time_ns() + number * hours * 3_600_000_000_000
        monkeypatch.setattr(time, "time_ns", lambda now=now: now)
        path = ring.next()
        file = record_file.RecordFile(path, "none", {})
        closed.append(file.close())
        ring.on_closed(closed[-1])
    assert [written.path.exists() for written in closed] == [True] * 3
    later = time.monotonic() + 31.0
    monkeypatch.setattr(time, "monotonic", lambda: later)
    ring.prune()
    assert [written.path.exists() for written in closed] == [False] * 3


def test_recordings_before_a_clock_setback_count_as_older(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep = RecordSection.model_validate({"keep": {"files": 2}}).keep
    folder = KeptFolder(tmp_path, keep)
    (tmp_path / f"{PREFIX}2026_01_01.mcap").touch()
    for name in ("2026_01_03", "1970_01_02", "1970_01_01"):
        monkeypatch.setattr(record_places, "stamp", lambda name=name: name)
        folder.base().with_suffix(".mcap").touch()
    folder.prune()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [f"{PREFIX}1970_01_0{n}.mcap" for n in (1, 2)]

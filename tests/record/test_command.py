"""``midspan record`` as a command, and the worker that it controls."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import yaml

from bridge.cli.arguments import span
from bridge.cli.daemon.record import megabytes
from bridge.cli.main import main
from bridge.hub.control import RECORDED
from bridge.hub.errors import HubError
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.record import triggers
from bridge.record.places import PREFIX, Files
from bridge.record.worker import RecordWorker
from tests.contract.hubside import HubSide
from tests.peers.hub.quick import QuickHub
from tests.peers.hub.recorded_robot import Robot, config, read, recording
from tests.support.status_documents import check_document
from tests.support.wait import until

STATUS = "midspan_msgs/msg/NavigationStatus"


@pytest.fixture(scope="module")
def hubs() -> Iterator[QuickHub]:
    hub = QuickHub()
    yield hub
    hub.stop_router()


@pytest.fixture
def robot(hubs: QuickHub) -> Iterator[Robot]:
    with Hub.open(hubs.settings("robot")) as hub:
        yield Robot(hub)


@pytest.fixture
def file(hubs: QuickHub, tmp_path: Path) -> Path:
    path = tmp_path / "midspan.yaml"
    hub = {key: value for key, value in hubs.config().items() if value is not None}
    path.write_text(yaml.safe_dump({"name": "robot1", "state": str(tmp_path / "state"), "hub": hub}))
    return path


@pytest.mark.parametrize(
    ("text", "value"), [("1GB", 1024), ("500 MB", 500), ("64", 64), ("2GiB", 2048), ("1.5g", 1536)]
)
def test_sizes_are_parsed(text: str, value: int) -> None:
    assert megabytes(text) == value


@pytest.mark.parametrize(("text", "value"), [("10m", 600.0), ("90s", 90.0), ("30", 30.0), ("1.5h", 5400.0), ("0", 0.0)])
def test_times_are_parsed(text: str, value: float) -> None:
    assert span(text) == value


@pytest.mark.parametrize("name", ["pipe", "pipe.mcap"])
def test_pipes_are_rejected(name: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / name)
    assert main(["record", "-a", "--duration", "1", "-o", str(tmp_path / name), "--config", str(file)]) == 1
    assert f"cannot record into {tmp_path / name}: it is a pipe or a device" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "name the topics to record"),
        (["-a", "--trigger", "/bumper"], "give --ring"),
        (["-a", "--side", "mars"], "sides"),
        (["--daemon", "split"], "set record.enabled"),
    ],
)
def test_invalid_options_are_reported(
    arguments: list[str], message: str, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", *arguments, "--config", str(file)]) == 1
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("--duration=-1s", "is not a time"), ("--duration=ten", "is not a time"), ("--ring=5 parsecs", "is not a time"),
        (f"--duration={10**400}h", "is too long"), ("-x(/camera", "'(/camera' is not a regular expression"),
    ],
)  # fmt: skip
def test_invalid_values_are_refused(argument: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["record", "-a", argument])
    assert message in capsys.readouterr().err


def test_an_existing_file_is_not_overwritten(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    existing = tmp_path / "there.mcap"
    existing.write_text("mine")
    assert main(["record", "-a", "-o", str(existing), "--config", str(file)]) == 1
    assert "there.mcap: File exists" in capsys.readouterr().err
    assert existing.read_text() == "mine"


def recorder(file: Path, *arguments: str, limit: str = "unlimited") -> subprocess.Popen[str]:
    """Start the command as a process; ``limit`` is the maximum file size in kilobytes."""
    command = [sys.executable, "-m", "bridge.cli.main", "record", *arguments, "--config", str(file)]
    return subprocess.Popen(
        ["bash", "-c", f"ulimit -f {limit}; exec {shlex.join(command)}"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_ctrl_c_ends_a_recording_with_a_summary(robot: Robot, file: Path, tmp_path: Path) -> None:
    publisher, latched = robot.publisher("/said"), robot.publisher("/kept", LATCHED)
    latched.put(robot.text("kept"))
    program = recorder(file, "/said", "/k*", "-o", str(tmp_path / "run"), "--folder", "--json")
    until(lambda: publisher.matched() or program.poll() is not None, "the topic is subscribed")
    for number in range(10):
        publisher.put(robot.text(str(number)))
    publisher.put(robot.text("last"))
    until(
        lambda: [a for a in robot.hub.ask("status", {}) if a.value["recording"]["messages"] == 12],
        "all messages are written",
    )
    program.send_signal(signal.SIGINT)
    out, err = program.communicate(timeout=30)
    assert program.returncode == 0, err
    result = json.loads(out)
    contents = read(tmp_path / "run" / "run_0.mcap")
    assert contents.whole
    assert contents.texts("/kept") == ["kept"]
    assert contents.texts("/said") == [*map(str, range(10)), "last"]
    assert (result["messages"], result["dropped"]) == (12, {})
    assert yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a thread's priority")
def test_the_recorder_yields_to_publishers(robot: Robot, file: Path, tmp_path: Path) -> None:
    """The recorder's threads have a lower priority than the main thread, which reports the recorder's health."""
    publisher = robot.publisher("/said")
    program = recorder(file, "/said", "-o", str(tmp_path / "run.mcap"))
    until(lambda: publisher.matched() or program.poll() is not None, "the topic is subscribed")
    of_all = {}
    for task in Path(f"/proc/{program.pid}/task").iterdir():
        with suppress(OSError):  # the thread has just ended
            thread = int(task.name)
            of_all[thread] = os.getpriority(os.PRIO_PROCESS, thread), os.sched_getscheduler(thread)
    program.send_signal(signal.SIGINT)
    program.communicate(timeout=30)
    usual, policy = of_all.pop(program.pid)
    assert policy == os.SCHED_OTHER
    yields = [priority_ for priority_ in of_all.values() if priority_ != (usual, policy)]
    low = min(usual + 5, 19)
    assert (low, os.SCHED_BATCH) in yields
    assert all(nice <= low for nice, _ in yields)


def has_subscriber(robot: Robot, topic: str) -> bool:
    return bool(robot.hub.graph.subscriptions(topic))


def test_a_failed_write_leaves_a_file_of_complete_chunks(robot: Robot, file: Path, tmp_path: Path) -> None:
    publisher = robot.publisher("/said", Qos(depth=1000))
    path = tmp_path / "run.mcap"
    program = recorder(file, "/said", "-o", str(path), "--compression", "none", limit=str(3 << 10))
    until(lambda: publisher.matched() or program.poll() is not None, "the topic is subscribed")
    try:
        for number in range(60):
            publisher.put(robot.text(f"{number:05}" + "x" * 100_000))
        err = program.stderr
        assert err is not None
        lines = iter(err.readline, "")
        assert any("not recording" in line and "File too large" in line for line in lines)
    finally:
        program.send_signal(signal.SIGINT)
        program.communicate(timeout=30)
    contents = read(path)
    numbers = [int(text[:5]) for text in contents.texts("/said")]
    assert numbers == list(range(len(numbers)))
    assert 20 < len(numbers) < 31
    assert path.stat().st_size <= 3 << 20
    assert program.returncode == 1


@pytest.fixture
def worker(hubs: QuickHub, tmp_path: Path) -> Iterator[RecordWorker]:
    """Return the daemon's worker with a ring."""
    worker_ = RecordWorker()
    worker_.start(config(hubs, tmp_path, enabled=True, ring={"seconds": 30.0}, exclude=["^/navigation"]))
    yield worker_
    worker_.stop()


def kept_reasons(folder: Path) -> list[str]:
    """Return the reason for each kept folder."""
    files = sorted((folder / "robot1" / "recordings").glob(f"{PREFIX}*/metadata.yaml"))
    return [read(max(file.parent.glob("*.mcap"))).metadata["midspan.end"]["trigger"] for file in files]


def test_halt_failed_goal_call_and_verb_keep_the_ring(
    worker: RecordWorker, robot: Robot, file: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(triggers, "QUIET_SECONDS", 0.0)
    publisher = robot.publisher("/said")
    until(publisher.matched, "the topic is subscribed")

    def after(step: str) -> None:
        written, received = len(kept_reasons(tmp_path)), worker_status(robot)["messages"]
        publisher.put(robot.text(step))
        until(lambda: worker_status(robot)["messages"] > received, "the message is in the ring")
        steps[step]()
        until(lambda: len(kept_reasons(tmp_path)) == written + 1, f"{step} writes the ring")

    status = robot.publisher("/navigation/status", LATCHED, STATUS)
    until(lambda: has_subscriber(robot, "/navigation/status"), "the gateway's status is subscribed")
    caller = HubSide(robot.hub, robot.registry)
    steps = {
        "halt": lambda: (
            [a.value for a in robot.hub.ask("halt", {}, timeout=20.0)] == [RECORDED] or pytest.fail("not recorded")
        ),
        "goal": lambda: [
            status.put(robot.message(STATUS, {"state": state, "reason": "no way"})) for state in ("moving", "aborted")
        ],
        "service": lambda: caller.call(triggers.SERVICE, "std_srvs/Trigger"),
        "verb": lambda: main(["record", "--daemon", "trigger", "--config", str(file)]),
    }
    for step in steps:
        after(step)
    assert kept_reasons(tmp_path) == [
        "halt", "a goal failed: no way", "a call to /record/trigger", "midspan record --daemon trigger",
    ]  # fmt: skip
    assert "the ring is in" in capsys.readouterr().out


def test_the_error_of_one_recorder_does_not_hide_the_other_recorders(
    hubs: QuickHub, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_params: object) -> object:
        raise HubError("split: the disk is full")

    with (
        Hub.open(hubs.settings("a", worker="record", daemon="robot1")) as first,
        Hub.open(hubs.settings("b", worker="record", daemon="robot2")) as second,
    ):
        first.serve("record", fail)
        second.serve("record", lambda _params: {"file": "/run.mcap"})
        until(lambda: len(first.ask("record", {})) == 2, "both recorders answer")
        assert main(["record", "--daemon", "split", "--config", str(file)]) == 1
    shown = capsys.readouterr()
    assert "robot2: closed /run.mcap" in shown.out
    assert "the recorder of robot1: split: the disk is full" in shown.err


def test_only_the_daemons_recorder_exports_metrics(hubs: QuickHub, robot: Robot, tmp_path: Path) -> None:
    with recording(hubs, tmp_path, Files(tmp_path / "one", split=False)):
        answers = until(lambda: robot.hub.ask("status", {}, worker="recorder"), "the recorder answers")
        assert answers[0].value.get("metrics", {}) == {}


def worker_status(robot: Robot) -> dict:  # type: ignore[type-arg]
    return next(a.value for a in robot.hub.ask("status", {}, worker="record", timeout=20.0))["recording"]  # type: ignore[no-any-return]


def test_health_and_metrics_show_what_is_written(worker: RecordWorker, robot: Robot) -> None:
    publisher = robot.publisher("/said")
    until(publisher.matched, "the topic is subscribed")
    publisher.put(robot.text("one"))
    until(lambda: worker_status(robot)["messages"] == 1, "the message is written")
    health = worker.health()
    assert health.state == "running"
    assert "1 messages" in health.text
    document = next(a.value for a in robot.hub.ask("status", {}, worker="record", timeout=20.0))
    check_document(document, "record")
    assert document["metrics"]["written_messages_total"] == 1
    assert document["metrics"]["dropped_disk_total"] == 0
    assert document["pid"] == os.getpid()

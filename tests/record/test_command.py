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
from bridge.hub.session import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.record import triggers
from bridge.record.places import PREFIX
from bridge.record.worker import RecordWorker
from tests.contract.hubside import HubSide
from tests.record.robot import Robot, config, read
from tests.support.quick_hub import QuickHub
from tests.support.wait import until

STATUS = "midspan_msgs/msg/NavigationStatus"


@pytest.fixture(scope="module")
def hubs() -> Iterator[QuickHub]:
    made = QuickHub()
    yield made
    made.stop_router()


@pytest.fixture
def robot(hubs: QuickHub) -> Iterator[Robot]:
    with Hub.open(hubs.settings("robot")) as hub:
        yield Robot(hub)


@pytest.fixture
def file(hubs: QuickHub, tmp_path: Path) -> Path:
    made = tmp_path / "midspan.yaml"
    hub = {key: value for key, value in hubs.config().items() if value is not None}
    made.write_text(yaml.safe_dump({"name": "robot1", "state": str(tmp_path / "state"), "hub": hub}))
    return made


@pytest.mark.parametrize(
    ("text", "value"), [("1GB", 1024), ("500 MB", 500), ("64", 64), ("2GiB", 2048), ("1.5g", 1536)]
)
def test_sizes(text: str, value: int) -> None:
    assert megabytes(text) == value


@pytest.mark.parametrize(("text", "value"), [("10m", 600.0), ("90s", 90.0), ("30", 30.0), ("1.5h", 5400.0), ("0", 0.0)])
def test_times(text: str, value: float) -> None:
    assert span(text) == value


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "name the topics to record"),
        (["-a", "--trigger", "/bumper"], "give --ring"),
        (["-a", "--side", "mars"], "sides"),
        (["--daemon", "split"], "set record.enabled"),
    ],
)
def test_mistakes_are_told(words: list[str], told: str, file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["record", *words, "--config", str(file)]) == 1
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("--duration=-1s", "is not a time"), ("--duration=ten", "is not a time"), ("--ring=5 parsecs", "is not a time"),
        (f"--duration={10**400}h", "is too long"), ("-x(/camera", "'(/camera' is not a regular expression"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused(word: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["record", "-a", word])
    assert told in capsys.readouterr().err


def test_a_file_that_is_there_is_not_written_over(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "there.mcap"
    there.write_text("mine")
    assert main(["record", "-a", "-o", str(there), "--config", str(file)]) == 1
    assert "there.mcap: File exists" in capsys.readouterr().err
    assert there.read_text() == "mine"


def recorder(file: Path, *words: str, limit: str = "unlimited") -> subprocess.Popen[str]:
    """Start the verb as a process; ``limit``: kilobytes that its files may have."""
    command = [sys.executable, "-m", "bridge.cli.main", "record", *words, "--config", str(file)]
    return subprocess.Popen(
        ["bash", "-c", f"ulimit -f {limit}; exec {shlex.join(command)}"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_a_recording_ends_with_ctrl_c_and_tells_what_it_wrote(robot: Robot, file: Path, tmp_path: Path) -> None:
    said, kept = robot.publisher("/said"), robot.publisher("/kept", LATCHED)
    kept.put(robot.text("kept"))
    program = recorder(file, "/said", "/k*", "-o", str(tmp_path / "run"), "--folder", "--json")
    until(lambda: said.matched() or program.poll() is not None, "it is heard")
    for number in range(10):
        said.put(robot.text(str(number)))
    said.put(robot.text("last"))
    until(lambda: [a for a in robot.hub.ask("status", {}) if a.value["recording"]["messages"] == 12], "it is written")
    program.send_signal(signal.SIGINT)
    out, err = program.communicate(timeout=30)
    assert program.returncode == 0, err
    told = json.loads(out)
    found = read(tmp_path / "run" / "run_0.mcap")
    assert found.whole
    assert found.texts("/kept") == ["kept"]
    assert found.texts("/said") == [*map(str, range(10)), "last"]
    assert (told["messages"], told["dropped"]) == (12, {})
    assert yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a thread's priority")
def test_who_is_recorded_goes_first(robot: Robot, file: Path, tmp_path: Path) -> None:
    """Its threads yield, once each; the main one, which reports its health, does not."""
    said = robot.publisher("/said")
    program = recorder(file, "/said", "-o", str(tmp_path / "run.mcap"))
    until(lambda: said.matched() or program.poll() is not None, "it is heard")
    of_all = {}
    for task in Path(f"/proc/{program.pid}/task").iterdir():
        with suppress(OSError):  # it has just ended
            thread = int(task.name)
            of_all[thread] = os.getpriority(os.PRIO_PROCESS, thread), os.sched_getscheduler(thread)
    program.send_signal(signal.SIGINT)
    program.communicate(timeout=30)
    usual, policy = of_all.pop(program.pid)
    assert policy == os.SCHED_OTHER
    yields = [each for each in of_all.values() if each != (usual, policy)]
    low = min(usual + 5, 19)
    assert (low, os.SCHED_BATCH) in yields
    assert all(nice <= low for nice, _ in yields)


def robot_hears(robot: Robot, topic: str) -> bool:
    return bool(robot.hub.graph.subscriptions(topic))


def test_a_write_that_the_system_refuses_leaves_a_file_of_whole_chunks(
    robot: Robot, file: Path, tmp_path: Path
) -> None:
    said = robot.publisher("/said", Qos(depth=1000))
    path = tmp_path / "run.mcap"
    program = recorder(file, "/said", "-o", str(path), "--compression", "none", limit=str(3 << 10))
    until(lambda: said.matched() or program.poll() is not None, "it is heard")
    try:
        for number in range(60):
            said.put(robot.text(f"{number:05}" + "x" * 100_000))
        err = program.stderr
        assert err is not None
        lines = iter(err.readline, "")
        assert any("not recording" in line and "File too large" in line for line in lines)
    finally:
        program.send_signal(signal.SIGINT)
        program.communicate(timeout=30)
    found = read(path)
    numbers = [int(text[:5]) for text in found.texts("/said")]
    assert numbers == list(range(len(numbers)))
    assert 20 < len(numbers) < 31
    assert path.stat().st_size <= 3 << 20
    assert program.returncode == 1


@pytest.fixture
def worker(hubs: QuickHub, tmp_path: Path) -> Iterator[RecordWorker]:
    """The daemon's worker with a ring."""
    made = RecordWorker()
    made.start(config(hubs, tmp_path, enabled=True, ring={"seconds": 30.0}, exclude=["^/navigation"]))
    yield made
    made.stop()


def kept(folder: Path) -> list[str]:
    """Why each folder was written."""
    found = sorted((folder / "robot1" / "recordings").glob(f"{PREFIX}*/metadata.yaml"))
    return [read(max(each.parent.glob("*.mcap"))).metadata["midspan.end"]["trigger"] for each in found]


def test_the_ring_is_written_by_a_halt_a_failed_goal_a_call_and_the_verb(
    worker: RecordWorker, robot: Robot, file: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(triggers, "QUIET_SECONDS", 0.0)
    said = robot.publisher("/said")
    until(said.matched, "it is heard")

    def after(what: str) -> None:
        said.put(robot.text(what))
        written = len(kept(tmp_path))
        until(lambda: worker_status(robot)["topics"], "it is told")
        steps[what]()
        until(lambda: len(kept(tmp_path)) == written + 1, f"{what} writes it")

    status = robot.publisher("/navigation/status", LATCHED, STATUS)
    until(lambda: robot_hears(robot, "/navigation/status"), "the gateway is followed")
    caller = HubSide(robot.hub, robot.registry)
    steps = {
        "halt": lambda: [a.value for a in robot.hub.ask("halt", {})] == [RECORDED] or pytest.fail("not recorded"),
        "goal": lambda: [
            status.put(robot.message(STATUS, {"state": state, "reason": "no way"})) for state in ("moving", "aborted")
        ],
        "service": lambda: caller.call(triggers.SERVICE, "std_srvs/Trigger"),
        "verb": lambda: main(["record", "--daemon", "trigger", "--config", str(file)]),
    }
    for what in steps:
        after(what)
    assert kept(tmp_path) == [
        "halt", "a goal failed: no way", "a call of /record/trigger", "midspan record --daemon trigger",
    ]  # fmt: skip
    assert "the ring is in" in capsys.readouterr().out


def worker_status(robot: Robot) -> dict:  # type: ignore[type-arg]
    return next(a.value for a in robot.hub.ask("status", {}, worker="record"))["recording"]  # type: ignore[no-any-return]


def test_the_workers_health_and_figures_tell_what_is_written(worker: RecordWorker, robot: Robot) -> None:
    said = robot.publisher("/said")
    until(said.matched, "it is heard")
    said.put(robot.text("one"))
    until(lambda: worker_status(robot)["messages"] == 1, "it is written")
    health = worker.health()
    assert health.state == "running"
    assert "1 messages" in health.text
    document = next(a.value for a in robot.hub.ask("status", {}, worker="record"))
    assert document["metrics"]["written_messages_total"] == 1
    assert document["metrics"]["dropped_disk_total"] == 0
    assert document["pid"] == os.getpid()

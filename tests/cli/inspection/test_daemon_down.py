"""A daemon or workers that do not run: each verb reports the true cause."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import resource
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml
import zenoh

from bridge.config.partial import load_partly
from bridge.daemon.query import ask_daemon
from tests.peers.daemon.robot_daemon import RobotDaemon
from tests.support.ports import free_port
from tests.support.wait import until
from tests.support.zenoh_router import open_router

DOWN = "the daemon robot is not running, although its router is (process {router})"
UNRESPONSIVE = "the router of robot (process {router}) listens at tcp/127.0.0.1:{port}, but accepts no connection"
STAND_IN = "tests.peers.daemon.stand_in:Modules"
Start = Callable[..., RobotDaemon]

NEED_THE_GATEWAY = (["nav", "status"], ["nav", "pause"], ["nav", "show"], ["goto", "kitchen"], ["goto", "-1.5", "2"])
NEED_THE_STORE = (["map", "list"], ["map", "show"], ["location", "list"], ["location", "add", "a", "1", "2"])
NEED_NOTHING = (["topic", "list"], ["service", "list"], ["tf", "list"], ["explain", "/scan"], ["top", "--once"])


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """A function that starts a daemon; to be called once."""
    daemons: list[RobotDaemon] = []

    def begin(order: str = "", **sections: Any) -> RobotDaemon:
        (tmp_path / "modules.do").write_text(order)
        daemons.append(RobotDaemon(tmp_path, STAND_IN if order else "", **sections))
        daemons[0].run()
        return daemons[0]

    yield begin
    for robot in daemons:
        robot.close()


@pytest.fixture(scope="module")
def dead(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[RobotDaemon, str]]:
    """A daemon that was killed with SIGKILL while its router lives, and the expected report."""
    robot = RobotDaemon(tmp_path_factory.mktemp("dead"))
    robot.run()
    robot.until_phase("modules", "running")
    router = robot.kill()
    yield robot, DOWN.format(router=router)
    robot.close()


def test_status_reports_a_dead_daemon(dead: tuple[RobotDaemon, str]) -> None:
    robot, down = dead
    done = robot.command("status")
    assert done.returncode == 1
    assert f"daemon   not running {down}" in " ".join(done.stdout.splitlines())
    assert "router   running" in done.stdout
    assert done.stderr.startswith(f"midspan: {down}\nstart the daemon: 'midspan run'")
    done = robot.command("status", "--json")
    documents = {document["worker"]: document for document in json.loads(done.stdout)}
    assert done.returncode == 1
    assert documents.keys() == {"daemon", "router"}
    assert documents["daemon"]["state"] == "not running"


def test_doctor_reports_a_dead_daemon_with_the_cure(dead: tuple[RobotDaemon, str]) -> None:
    robot, down = dead
    done = robot.command("doctor", "--only", "daemon", "--json")
    assert done.returncode == 1
    first, *others = json.loads(done.stdout)
    assert (first["result"], first["seen"]) == ("fail", down)
    assert first["cure"].startswith("start the daemon: 'midspan run'")
    assert [(check["result"], check["seen"]) for check in others] == [("ok", "robot/router is running")]


@pytest.mark.parametrize("words", [*NEED_THE_GATEWAY, *NEED_THE_STORE, ["record", "--daemon", "trigger"]], ids=" ".join)
def test_verbs_that_need_a_worker_fail_with_the_cause(dead: tuple[RobotDaemon, str], words: list[str]) -> None:
    robot, down = dead
    done = robot.command(*words)
    assert done.returncode == 1
    assert done.stderr.count(down) >= 1, done
    assert "name a planner" not in done.stderr
    assert "set store.enabled" not in done.stderr
    assert "record.enabled" not in done.stderr
    assert done.stderr.splitlines()[-1].endswith(down), "the last line of the error names the cause"


@pytest.mark.parametrize("words", [*NEED_NOTHING, ["halt", "--seconds", "0.1"], ["nav", "stop"]], ids=" ".join)
def test_other_verbs_mention_the_dead_daemon(dead: tuple[RobotDaemon, str], words: list[str]) -> None:
    robot, down = dead
    assert down in robot.command(*words).stderr


def test_a_command_waits_for_a_router_that_answers_late(dead: tuple[RobotDaemon, str]) -> None:
    """Signals simulate a busy machine; the router's port accepts connections all the time."""
    robot, down = dead
    router = psutil.Process(int(re.findall(r"\d+", down)[-1]))
    router.suspend()
    try:
        listing = robot.midspan("topic", "list")
        until(lambda: "has not answered for 2 s, although it listens" in listing.output(), "the command waits", 40)
    finally:
        router.resume()
    assert listing.popen.wait(40) == 0, listing.output()
    assert "no zenoh router answers" not in listing.output()


@pytest.mark.thorough
def test_a_dead_daemon_of_another_user_is_recognized(dead: tuple[RobotDaemon, str], tmp_path: Path) -> None:
    """The state folder cannot be read, but the process table shows that the router has lost its daemon."""
    robot, down = dead
    file = tmp_path / "other.yaml"
    file.write_text(json.dumps({**yaml.safe_load(robot.file.read_text()), "state": str(tmp_path / "none")}))
    before, robot.file = robot.file, file
    try:
        done = robot.command("status")
    finally:
        robot.file = before
    assert (done.returncode, done.stderr.startswith(f"midspan: {down}\n")) == (1, True), done


@pytest.mark.thorough
def test_standalone_router_needs_no_daemon(tmp_path: Path) -> None:
    with contextlib.closing(RobotDaemon(tmp_path)) as robot:
        robot.midspan("worker", "router")
        done = until(lambda: (done := robot.command("status")).returncode == 0 and done, "the router answers", 40)
        assert "not running" not in done.stdout + done.stderr
        assert (
            "no gateway runs on this hub: no daemon robot runs on this machine" in robot.command("nav", "status").stderr
        )


def test_a_daemon_that_runs_again_is_not_reported(start: Start) -> None:
    robot = start()
    robot.until_phase("modules", "running")
    robot.kill()
    assert robot.command("status").returncode == 1
    robot.run()
    robot.until_phase("modules", "running")
    done = robot.command("status")
    assert (done.returncode, done.stderr) == (0, "")
    done = robot.command("nav", "status")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.thorough
def test_a_hanging_daemon_is_reported(start: Start) -> None:
    robot = start("run")
    robot.until_phase("modules", "running")
    assert robot.daemon is not None
    os.kill(robot.daemon.pid, signal.SIGSTOP)
    hangs = f"the daemon robot (process {robot.daemon.pid}) does not answer"
    for command in (["status"], ["doctor", "--only", "daemon"], ["nav", "status"], ["map", "list"]):
        done = robot.command(*command)
        assert (done.returncode, hangs in done.stdout + done.stderr) == (1, True), done


def test_a_worker_that_keeps_crashing_is_reported(start: Start) -> None:
    robot = start("crash")
    robot.until_phase("modules", "restarting", 3)
    crashes = r"the worker 'modules' of robot is (restarting|starting|queued): .*restarted \d+ times"
    for command in (*NEED_THE_GATEWAY[:4], *NEED_THE_STORE[:2]):
        done = robot.command(*command)
        assert done.returncode == 1
        assert re.search(crashes, done.stderr), (command, done.stderr)
        assert "ended with exit code 7" in done.stderr
        assert "name a planner" not in done.stderr
    assert "'modules'" in robot.command("topic", "list").stderr
    done = robot.command("status")
    assert done.returncode == 0
    assert "modules" in done.stdout
    assert "last end: ended with exit code 7" in done.stdout
    findings = json.loads(robot.command("doctor", "--only", "daemon", "--json").stdout)
    (loop,) = [finding for finding in findings if "robot/modules" in finding["seen"]]
    assert loop["result"] == "fail"
    assert "robot/modules crashes again and again" in loop["seen"]


def test_worker_that_was_restarted_is_shown_with_the_reason(start: Start) -> None:
    robot = start(record={"enabled": True})
    pid = robot.until_phase("record", "running")["pid"]
    os.kill(pid, signal.SIGSEGV)
    robot.until_phase("record", "running", 1)
    restarted = "restarted once; last end: killed by SIGSEGV"

    def answers() -> dict[str, Any] | None:
        documents = json.loads(robot.command("status", "--json").stdout)
        return next((d for d in documents if (d["worker"], d["state"]) == ("record", "running")), None)

    document = until(answers, "the new process answers")
    assert (document["restarts"], document["ended"]) == (1, "killed by SIGSEGV")
    assert restarted in robot.command("status").stdout
    findings = json.loads(robot.command("doctor", "--only", "daemon", "--json").stdout)
    (finding,) = [finding for finding in findings if "robot/record" in finding["seen"]]
    assert (finding["result"], finding["seen"]) == ("ok", f"robot/record is running ({restarted})")


@pytest.mark.thorough
def test_a_worker_that_is_starting_is_named(start: Start) -> None:
    robot = start("hang")
    robot.until_phase("modules", "starting")
    for command in (["nav", "status"], ["goto", "kitchen"], ["map", "list"]):
        done = robot.command(*command)
        assert (done.returncode, "the worker 'modules' of robot is starting" in done.stderr) == (1, True), done


def test_a_missing_planner_in_the_configuration_is_reported(start: Start) -> None:
    robot = start(navigation={})
    robot.until_phase("modules", "running")
    done = robot.command("nav", "status")
    assert done.returncode == 1
    assert "no gateway is configured: name a planner in the section 'navigation'" in done.stderr


def test_a_router_that_cannot_work_is_reported(start: Start) -> None:
    """Another program uses the router's port; the daemon runs, and knows the reason."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        robot = start("run", hub={"listen": f"tcp/127.0.0.1:{other.getsockname()[1]}"})
        robot.until_phase("router", "cannot work")
        for command in (["nav", "status"], ["topic", "list"]):
            done = robot.command(*command)
            assert done.returncode == 1
            assert "the worker 'router' of robot cannot work: tcp/127.0.0.1" in done.stderr
            assert "Is the daemon running?" not in done.stderr
        done = robot.command("status")
        assert "cannot work" in done.stdout


def test_without_router_and_daemon_the_error_names_the_command_that_starts_it(
    dead: tuple[RobotDaemon, str], tmp_path: Path
) -> None:
    robot = dead[0]
    file = tmp_path / "other.yaml"
    file.write_text(
        json.dumps({**yaml.safe_load(robot.file.read_text()), "hub": {"listen": f"tcp/127.0.0.1:{free_port()}"}})
    )
    before, robot.file = robot.file, file
    try:
        done = robot.command("topic", "list")
    finally:
        robot.file = before
    assert done.returncode == 1
    assert "the daemon robot is not running" in done.stderr
    assert "start the daemon: 'midspan run'" in done.stderr
    assert "although it listens" not in done.stderr, "the command does not wait for a router that is down"


@pytest.mark.thorough
def test_a_configuration_that_the_daemon_has_not_loaded_is_reported(start: Start) -> None:
    robot = start(navigation={}, modules={})
    robot.until_phase("router", "running")
    robot.configure()
    for command in (["nav", "status"], ["map", "list"]):
        done = robot.command(*command)
        assert (done.returncode, "it has not loaded this configuration" in done.stderr) == (1, True), done
        assert "'midspan reload' makes it load its file again" in done.stderr


@pytest.mark.parametrize("broken", ["clock: {source: simm}", "log: ["])
def test_a_broken_file_does_not_hide_a_daemon_that_runs_regardless(start: Start, broken: str) -> None:
    robot = start()
    robot.until_phase("modules", "running")
    good = robot.file.read_text()
    robot.file.write_text(f"{good}{broken}\n")
    assert robot.command("reload").returncode == 1
    robot.daemon.signal(signal.SIGHUP)

    def is_refused() -> bool:
        """Return whether the daemon has refused the file; a busy daemon may not answer in time."""
        status = ask_daemon(load_partly(robot.file), 20.0)
        return status is not None and f"{robot.file}:" in status.refused

    until(is_refused, "the daemon has refused the file", 20)
    for words in (["status"], ["top", "--once"], ["explain", "/scan"], ["nav", "status"]):
        done = robot.command(*words)
        assert done.stderr.count("the rest of the file is used") == 1, done
        assert "did you mean" in done.stderr or broken == "log: [", done
    done = robot.command("status")
    assert (done.returncode, "router   running" in done.stdout) == (0, True), done
    assert "warning: it refused its last reload, and uses its earlier configuration: " in done.stdout
    assert "then run 'midspan reload'" in done.stdout
    done = robot.command("doctor", "--only", "config", "--only", "daemon")
    assert "the hub was not queried" not in done.stdout
    assert "start the daemon" not in done.stdout
    assert "the daemon robot: it refused its last reload" in done.stdout
    assert "robot/router is running" in done.stdout
    robot.file.write_text(good)
    assert "it refused its last reload" in robot.command("doctor", "--only", "config").stdout, "still the old one"
    assert robot.command("reload").returncode == 0
    assert "refused" not in robot.command("status").stdout + robot.command("doctor", "--only", "config").stdout


def other_state(robot: RobotDaemon, folder: Path) -> None:
    """Let the commands read a configuration with another state folder, as the commands of another user would."""
    file = folder / "other.yaml"
    file.write_text(json.dumps({**yaml.safe_load(robot.file.read_text()), "state": str(folder / "none")}))
    robot.file = file


@pytest.mark.parametrize("words", [["run"], ["run", "--adopt", "router"]], ids=" ".join)
def test_status_reports_another_program_at_the_port(tmp_path: Path, words: list[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        place = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        with contextlib.closing(RobotDaemon(tmp_path, hub={"listen": place}, navigation={}, modules={})) as robot:
            robot.midspan(*words)
            robot.until_phase("router", "restarting" if "--adopt" in words else "cannot work")
            done = robot.command("status")
            assert done.returncode == 1, done
            assert "router   restarting" in done.stdout or "router   cannot work" in done.stdout
            assert "held by a program" in done.stderr or f"Another program holds {place}" in done.stderr
            other_state(robot, tmp_path)
            for verb in (["status"], ["topic", "list"], ["top", "--once"]):
                done = robot.command(*verb)
                assert done.returncode == 1
                assert (
                    f"Another program holds {place}: it is not a zenoh router. Stop it, set hub.listen" in done.stderr
                )
                assert "Is the daemon running?" not in done.stderr


def test_status_finds_a_daemon_that_uses_a_router_of_another_project(tmp_path: Path) -> None:
    """The daemon uses that router, and may have no worker that replies on the hub."""
    config = zenoh.Config()
    place = f"tcp/127.0.0.1:{free_port()}"
    for key, value in (("mode", "router"), ("listen/endpoints", [place]), ("scouting/multicast/enabled", False)):
        config.insert_json5(key, json.dumps(value))
    robot = RobotDaemon(tmp_path, hub={"listen": place}, navigation={}, modules={})
    with open_router(config):
        try:
            robot.run()
            robot.until_phase("router", "running")
            done = robot.command("status")
            assert (done.returncode, done.stderr) == (0, "")
            assert "router   running  standby: a zenoh router that is not Midspan's" in " ".join(
                done.stdout.splitlines()
            )
            done = robot.command("top", "--once")
            assert done.returncode == 1
            assert "Is the daemon running" not in done.stderr
            assert "The daemon robot is running" in done.stderr
        finally:
            robot.close()


def test_status_finds_a_daemon_whose_router_is_down(tmp_path: Path) -> None:
    """`hub.router: false`: the configured router is elsewhere, and down."""
    with contextlib.closing(
        RobotDaemon(tmp_path, navigation={}, hub={"listen": f"tcp/127.0.0.1:{free_port()}", "router": False})
    ) as robot:
        robot.run()
        robot.until_phase("modules", "running")
        for command in (["status"], ["topic", "list"]):
            done = robot.command(*command)
            assert done.returncode == 1, done
            assert ("modules  running" in done.stdout) == (command == ["status"])
            assert "the daemon robot is running" in done.stderr
            assert "Is the daemon running?" not in done.stderr


def exhaust(pid: int) -> None:
    """Limit a process's open files to the lowest unused number, so that it cannot accept another connection."""

    def unused() -> int:
        used = {int(entry.name) for entry in Path(f"/proc/{pid}/fd").iterdir()}
        return next(number for number in itertools.count() if number not in used)

    _, hard = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (min(unused() for _ in range(20)), hard))  # some are open for moments


def test_a_router_that_accepts_no_connection_is_reported(tmp_path: Path) -> None:
    """The kernel completes connections to the router's port, which get no reply; no other program is the cause."""
    with contextlib.closing(RobotDaemon(tmp_path, navigation={}, modules={})) as robot:
        robot.run()
        router = robot.until_phase("router", "running")["pid"]
        exhaust(router)
        cause = UNRESPONSIVE.format(router=router, port=robot.port)
        for command in (["status"], ["topic", "list"]):
            done = robot.command(*command)
            assert done.returncode == 1
            assert cause in done.stderr
            assert "midspan doctor" in done.stderr
            assert "Another program" not in done.stderr
            assert ("router   running" in done.stdout) == (command == ["status"])
        done = robot.command("doctor", "--only", "router-port", "--only", "descriptors")
        assert done.returncode == 1
        assert f"FAIL  router-port: {cause}" in done.stdout
        assert re.search(r"FAIL  descriptors: robot/router has \d+ files open of \d+ allowed", done.stdout)
        assert "stop that program" not in done.stdout


def test_a_daemon_suspended_with_its_router_is_reported(tmp_path: Path) -> None:
    """Ctrl-Z in the daemon's terminal does this."""
    with contextlib.closing(RobotDaemon(tmp_path, navigation={}, modules={})) as robot:
        robot.run()
        router = robot.until_phase("router", "running")["pid"]
        assert robot.daemon is not None
        for pid in (robot.daemon.pid, router):
            os.kill(pid, signal.SIGSTOP)
        done = robot.command("status")
        assert done.returncode == 1
        assert f"the daemon robot (process {robot.daemon.pid}) does not answer" in done.stderr
        assert "Another program" not in done.stderr
        robot.daemon.popen.kill()
        robot.daemon.popen.wait(20)
        done = robot.command("status")
        assert done.returncode == 1
        assert DOWN.format(router=router) in done.stderr
        assert UNRESPONSIVE.format(router=router, port=robot.port) in done.stderr
        assert "Another program" not in done.stderr

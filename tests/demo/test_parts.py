"""The demo's own logic: the simulated robot, the received topics, the checks."""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest

from bridge.cli.main import build_parser
from bridge.client.errors import ClientError
from bridge.demo import command, leftovers, rooms, sandbox
from bridge.demo.processes import guarded
from bridge.demo.sandbox import CLIENT, Sandbox
from bridge.demo.topics_demo import messages
from bridge.demo.topics_demo.checks import ROS1, ROS2, YARP, YARP_TEXT, ZENOH, Drive, evaluate, expectations
from bridge.demo.topics_demo.report import TopicReceived

ROOT = Path(__file__).parents[2]
MAP = "180 x 105 cells, CRC 00000000"
IMAGE = "8 x 6 rgb8, 144 bytes"
DRIVE = Drive(ROS2, (0.3, 0.0), (0.0, 0.0, 0.0), (0.8, 0.0, 0.0), 25, 25, (0.0, 0.0), seen=True)


def test_a_duplicated_message_is_counted() -> None:
    ear = TopicReceived()
    for key in (1, 2, 2, None, None):
        ear.add(key, "text")
    assert ear.as_dict() == {"count": 5, "repeated": 1, "detail": "text"}


def reports() -> dict[str, dict[str, Any]]:
    """Return the programs' reports of a run in which everything was bridged."""
    greetings = {
        messages.FROM_ROS1: "hello 9 from ROS 1",
        messages.FROM_ROS2: "hello 9 from ROS 2",
        messages.FROM_ZENOH: "hello 9 from zenoh",
        messages.FROM_YARP: "hello 9 from YARP",
    }
    robot = {expectation.topic: expectation.reads for expectation in expectations(MAP, IMAGE)} | greetings

    def topic_reports(reads: dict[str, str]) -> dict[str, Any]:
        return {"heard": {topic: {"count": 100, "repeated": 0, "detail": text} for topic, text in reads.items()}}

    return {
        ROS1: {**topic_reports(greetings), "map": MAP, "image": IMAGE},
        **{name: topic_reports(robot) for name in (ROS2, ZENOH, YARP)},
    }


def failed(all_reports: dict[str, dict[str, Any]], *drives: Drive) -> set[tuple[str, str, str]]:
    return {(c.name, c.target, c.topic) for c in evaluate(all_reports, drives) if not c.ok}


ALL = (DRIVE, *(replace(DRIVE, source=name) for name in (ZENOH, YARP, YARP_TEXT)))


def test_checks_pass_when_everything_is_bridged() -> None:
    assert failed(reports(), *ALL) == set()


@pytest.mark.parametrize(
    ("topic", "change", "name"),
    [
        (messages.SCAN, {"count": 3}, "laser scan"),
        (messages.MAP, {"detail": "180 x 105 cells, CRC ffffffff"}, "map, joined late"),
        (messages.TF_STATIC, {"detail": "camera, laser"}, "static transforms, joined late"),
        (messages.ODOM, {"repeated": 1}, "odometry"),
    ],
)
def test_checks_name_missing_wrong_and_duplicated_messages(topic: str, change: dict[str, Any], name: str) -> None:
    all_reports = reports()
    all_reports[ROS2]["heard"][topic] |= change
    assert failed(all_reports, *ALL) == {(name, ROS2, topic)}


def test_checks_detect_an_echo() -> None:
    all_reports = reports()
    all_reports[ROS1]["heard"][messages.FROM_ROS1]["repeated"] = 2
    assert ("no echo", ROS1, messages.FROM_ROS1) in failed(all_reports, *ALL)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"after": (0.05, 0.0, 0.0)}, {"drive", "timeout stops it"}),
        ({"velocity": (0.3, 0.0)}, {"timeout stops it"}),
        ({"seen": False}, {"drive seen"}),
    ],
)
def test_checks_detect_a_robot_that_ignores_commands(change: dict[str, Any], names: set[str]) -> None:
    checks = evaluate(reports(), (replace(DRIVE, **change), *ALL[1:]))
    assert {check.name for check in checks if not check.ok} == names


def test_missing_reports_and_drives_fail() -> None:
    checks = evaluate({ROS1: {}, ROS2: {}, ZENOH: {}, YARP: {}}, ())
    assert not any(check.ok for check in checks)


def test_sandboxes_are_isolated() -> None:
    with Sandbox(None) as first, Sandbox(None) as other:
        assert first.domain != other.domain
        ports = {port for box in (first, other) for port in (box.master_port, box.router_port, box.yarp_port)}
        assert len(ports) == 6
        assert first.config.ros1.master == first.master
        assert first.config.hub.listen.endswith(f":{first.router_port}")
        folders = (first.folder, other.folder)
    assert not any(folder.exists() for folder in folders)


def test_a_sandbox_keeps_the_rules_of_its_template(tmp_path: Path) -> None:
    template = tmp_path / "rules.yaml"
    template.write_text(
        "name: mine\nhub: {listen: tcp/127.0.0.1:7447}\nrouting:\n  rules:\n    - {topic: /a, deny: true}\n"
    )
    with Sandbox(template) as box:
        assert box.config.routing.rules[0].deny
        assert box.config.name != "mine"
        assert not box.config.hub.listen.endswith(":7447")


NO_ROSCORE = "ROS 1: Midspan's own master, because this machine has no roscore"
NO_ROSPY = "ROS 1: Midspan's own client, because this machine has no rospy"
NEITHER = "ROS 1: Midspan's own master and client, because this machine has no roscore and no rospy"


@pytest.mark.parametrize(
    ("programs", "packages", "line"),
    [
        ((), (), NEITHER),
        ((), ("rospy", *CLIENT), NO_ROSCORE),
        (("roscore",), ("rospy",), NO_ROSPY),
        (("roscore",), ("rospy", *CLIENT), ""),
    ],
)
def test_midspan_replaces_what_a_machine_lacks_of_ros1(
    tmp_path: Path, programs: tuple[str, ...], packages: tuple[str, ...], line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("bridge.demo.rospy_packages._NEEDED", ())
    folder = tmp_path / "lib" / "python3" / "dist-packages"
    for package in packages:
        (folder / package).mkdir(parents=True)
        (folder / package / "__init__.py").touch()
    folder.mkdir(parents=True, exist_ok=True)
    (tmp_path / "bin").mkdir()
    for program in programs:
        (tmp_path / "bin" / program).touch(0o755)
    template = tmp_path / "template.yaml"
    template.write_text(f"ros1: {{packages: {folder}}}\n")
    with Sandbox(template) as box:
        assert rooms.replace_ros1(box) == line
        assert box.config.ros1.enabled
        assert box.config.ros1.embedded_uri == ("" if programs else box.master)


def test_the_settings_of_a_user_do_not_reach_the_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MIDSPAN_CONFIG", "MIDSPAN_SIDES", "MIDSPAN_WORKERS", "ROS_MASTER_URI", "YARP_LOG_LEVEL"):
        monkeypatch.setenv(name, "mine")
    monkeypatch.setenv("MIDSPAN_CACHE", "/packages")
    with Sandbox(None) as box:
        environ = box.environment()
    assert "mine" not in environ.values()
    assert environ["MIDSPAN_CACHE"] == "/packages", "the built message packages are found"


def test_the_shipped_configuration_is_valid() -> None:
    from bridge.demo.sandbox import CONFIG

    with Sandbox(CONFIG) as box:
        assert box.config.routing.rules


def test_shared_memory_of_others_is_preserved() -> None:
    ports = range(10000, 10250)
    own_names = [
        n for n in ("12.zenoh", "fastrtps_0123456789abcdef", "fastrtps_port10011_el") if leftovers.is_own(n, ports)
    ]
    assert len(own_names) == 3
    others = ("lttng-ust-wait-6", "fastrtps_port7000", "sem.fastrtps_port9999_mutex", "psm_1234", "zenoh")
    assert not any(leftovers.is_own(name, ports) for name in others)


HOLDS = """
import fcntl, sys

held = [open(name, "ab") for name in sys.argv[1:]]
for file in held:
    fcntl.flock(file, fcntl.LOCK_SH)
print("held", flush=True)
sys.stdin.read()
"""
"""A program that creates files and locks them. Sessions of other tests remove zenoh's files without a lock."""


def test_an_unlocked_port_of_a_killed_participant_is_removed(tmp_path: Path) -> None:
    """A port of another process that holds its lock stays. No participant has a port number above 65535."""
    stem = f"fastrtps_port{70_000 + os.getpid()}"
    mine, others = (Path("/dev/shm", f"{stem}{end}") for end in "01")
    lock = others.with_name(f"{others.name}_el")
    command = [sys.executable, "-c", HOLDS, str(mine), str(others)]
    environ = os.environ | {sandbox.MARK: str(tmp_path)}
    try:
        with lock.open("w") as held:
            fcntl.flock(held, fcntl.LOCK_EX)
            with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environ) as participant:
                assert participant.stdout is not None
                assert participant.stdout.readline() == b"held\n"
                leftovers.erase(tmp_path, range(0))
        assert (mine.exists(), others.exists(), lock.exists()) == (False, True, True)
        assert not mine.with_name(f"{mine.name}_el").exists()
    finally:
        for file in (mine, others, lock):
            file.unlink(missing_ok=True)


def test_shared_memory_is_removed_although_the_demo_itself_still_uses_it(tmp_path: Path) -> None:
    """A demo's own session may hold the memory of a worker for a moment after it was closed."""
    file = Path("/dev/shm", f"{70_000 + os.getpid()}.zenoh")
    memory = leftovers.SharedMemory(tmp_path, range(0))
    try:
        with subprocess.Popen(
            [sys.executable, "-c", HOLDS, str(file)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {sandbox.MARK: str(tmp_path)},
        ) as worker:
            assert worker.stdout is not None
            assert worker.stdout.readline() == b"held\n"
            memory.note()
            memory.remove()
            assert file.exists(), "the worker still uses it"
            own = file.open("rb")
        with own:
            memory.remove()
        assert not file.exists()
    finally:
        file.unlink(missing_ok=True)


def test_missing_software_is_reported_with_its_cure(tmp_path: Path) -> None:
    from bridge.config.model import Config

    config = Config.model_validate({"ros1": {"packages": str(tmp_path)}})
    assert str(tmp_path) in sandbox.without_rospy(config, sandbox.ROBOT)
    (tmp_path / "rospy").mkdir()
    (tmp_path / "rospy" / "__init__.py").touch()
    for package in ("rosgraph", "rosgraph_msgs", "roscpp", "genpy", "std_msgs"):
        (tmp_path / package).mkdir()
    assert "apt install python3-nav-msgs" in sandbox.without_rospy(config, ("nav_msgs",))


@pytest.mark.parametrize("what", ["rooms", "topics"])
@pytest.mark.parametrize("module", ["rclpy", "dartpy", "zenoh_ros2_sdk"])
def test_a_demo_without_a_package_names_the_extra_that_has_it(
    monkeypatch: pytest.MonkeyPatch, what: str, module: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)  # the module cannot be imported
    monkeypatch.setattr("bridge.adapters.ros2.environment._SYSTEM", Path("/nonexistent"))
    monkeypatch.setattr("sim.environment.has_wheel", lambda: True)  # DART publishes none for Python 3.14
    args = build_parser(["demo"]).parse_args(["demo", what])
    with pytest.raises(ClientError, match=r"(?s)needs more than this machine has:.*pip install 'midspan\[demo\]'"):
        command.run(args)


@pytest.mark.parametrize(
    ("system", "machine", "version"),
    [("darwin", "arm64", (3, 13)), ("linux", "aarch64", (3, 13)), ("linux", "x86_64", (3, 14))],
)
def test_the_extra_is_named_only_where_it_has_all_packages(
    monkeypatch: pytest.MonkeyPatch, system: str, machine: str, version: tuple[int, int]
) -> None:
    monkeypatch.setattr("sim.environment.sys", SimpleNamespace(platform=system, version_info=version))
    monkeypatch.setattr("platform.machine", lambda: machine)
    with pytest.raises(ClientError) as raised:
        command._require(["ROS 2: no", "simulation: no", "zenoh: no"])
    assert "midspan[demo]" not in str(raised.value)


def test_a_demo_that_lacks_compiled_kernels_only_does_not_name_the_extra() -> None:
    with pytest.raises(ClientError) as raised:
        command._require(["kernels: they are not compiled"])
    assert "midspan[demo]" not in str(raised.value)


def test_a_sandboxes_ports_are_outside_the_ephemeral_range() -> None:
    with Sandbox(None) as first, socket.socket() as taken:
        low, domain = first.master_port, first.domain
        taken.bind(("127.0.0.1", first.router_port))
        free = sandbox.free_ports(3, domain)
        assert first.router_port not in free
        assert max(*free, first.yarp_port) < 32_768  # where Linux's default net.ipv4.ip_local_port_range begins
        assert low == free[0]


def test_a_hanging_program_ends_with_its_input() -> None:
    """This happens to rospy if its master dies during registration."""
    waits = (
        "from bridge.demo.topics_demo import report; report.LAST_SECONDS = 1; report.Reporter();"
        " import time; time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", waits], stdin=subprocess.PIPE, cwd=ROOT) as program:
        assert program.stdin is not None
        program.stdin.close()
        assert program.wait(30) == -signal.SIGALRM


LEAVES_ONE_BEHIND = """
import subprocess, sys, time
sleep = [sys.executable, "-c", "import time; time.sleep(600)"]
print(subprocess.Popen(sleep, start_new_session=True, stdout=subprocess.DEVNULL).pid, flush=True)
time.sleep(600)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="orphans are found on Linux")
def test_a_guard_kills_what_its_command_left() -> None:
    """For example, a killed daemon leaves its router, and a roscore leaves its master."""
    command = [str(part) for part in guarded(sys.executable, "-c", LEAVES_ONE_BEHIND)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as guard:
        assert guard.stdin is not None
        assert guard.stdout is not None
        left = int(guard.stdout.readline())
        assert psutil.pid_exists(left)
        guard.stdin.close()
        guard.wait(30)
    assert not psutil.pid_exists(left)

"""The systemd units of several daemons on one machine: their names, their state, and the doctor's check of them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.cli.main import main
from bridge.config.load import load
from bridge.daemon import units
from bridge.daemon.units import log_hint, start_hint, unit_of, units_in_use
from bridge.doctor.check import Result
from bridge.doctor.checks.daemon import check_services
from bridge.doctor.daemon_state import Life, daemon_state
from tests.doctor.parts import around, every, only
from tests.peers.daemon.robot_daemon import RobotDaemon
from tests.support.wait import until


def test_only_configurations_in_etc_midspan_have_units_of_their_own() -> None:
    assert unit_of("/etc/midspan/robot2.yaml") == "midspan@robot2"
    assert unit_of(Path("/etc/midspan/robot-3.yaml")) == "midspan@robot-3"
    for file in (None, "/etc/midspan/midspan.yaml", "robot2.yaml", "/home/a/robot2.yaml", "/etc/midspan/keys/a.yaml"):
        assert unit_of(file) == "midspan"
    assert start_hint("midspan@robot2") == (
        "start the daemon: 'systemctl start midspan@robot2'; 'journalctl -u midspan@robot2' shows why it exited"
    )


def test_systems_without_systemd_get_no_advice_to_use_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.daemon.units.sys", SimpleNamespace(platform="darwin"))
    assert start_hint("midspan") == "start the daemon: 'midspan run'"
    assert log_hint("midspan") == "see the log of 'midspan run'"


class System:
    """A root folder with configurations and systemd's links for enabled and active units."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.wants = root / "etc/systemd/system/multi-user.target.wants"
        for folder in (self.wants, root / "etc/midspan", root / "run/systemd/units"):
            folder.mkdir(parents=True)

    def enable(self, unit: str) -> None:
        (self.wants / f"{unit}.service").symlink_to(f"/etc/systemd/system/{unit}.service")

    def activate(self, unit: str) -> None:
        (self.root / "run/systemd/units" / f"invocation:{unit}.service").symlink_to("9a0e")

    def configure(self, instance: str, /, **sections: Any) -> Path:
        file = self.root / f"etc/midspan/{instance}.yaml"
        file.write_text(json.dumps(sections))
        return file

    def findings(self) -> list[tuple[Result, str, str]]:
        result = every(check_services(around(root=self.root)))
        return [(finding.result, finding.seen, finding.cure) for finding in result]


@pytest.fixture
def system(tmp_path: Path) -> System:
    return System(tmp_path)


def test_units_in_use_are_enabled_or_active(system: System) -> None:
    for unit in ("midspan", "midspan-router", "midspan-router@robot2", "midspan@robot2"):
        system.enable(unit)
    for unit in ("midspan@robot2", "midspan@by-hand", "midspan-router@by-hand"):
        system.activate(unit)
    folder = system.root / "etc/midspan"
    assert units_in_use(system.root) == {
        "midspan": folder / "midspan.yaml",
        "midspan@by-hand": folder / "by-hand.yaml",
        "midspan@robot2": folder / "robot2.yaml",
    }
    assert units_in_use(system.root / "nowhere") == {}


def test_the_doctor_compares_the_services(system: System) -> None:
    assert only(check_services(around(root=system.root))).result is Result.SKIP
    system.enable("midspan")
    system.configure("midspan", name="robot1")
    assert only(check_services(around(root=system.root))).result is Result.SKIP
    system.enable("midspan@robot2")
    second = system.configure("robot2", name="robot2", ros2={"domain": 2})
    assert system.findings() == [
        (Result.OK, f"midspan is the daemon robot1 ({system.root}/etc/midspan/midspan.yaml)", ""),
        (Result.OK, f"midspan@robot2 is the daemon robot2 ({second})", ""),
    ]


@pytest.mark.parametrize(
    ("first", "second", "shared", "key"),
    [
        ({"name": "robot1"}, {"name": "robot1"}, "name: robot1", "name"),
        (
            {"name": "a", "web": {"enabled": True}},
            {"name": "b", "web": {"enabled": True}},
            "web.listen: 127.0.0.1:",
            "web.listen",
        ),
        (
            {"name": "a", "hub": {"open": {"listen": ["tls/0.0.0.0:7448"]}}},
            {"name": "b", "hub": {"open": {"listen": ["tls/0.0.0.0:7449", "tls/0.0.0.0:7448"]}}},
            "hub.open.listen: tls/0.0.0.0:7448",
            "hub.open.listen",
        ),
    ],
    ids=["name", "console", "listener"],
)
def test_the_doctor_finds_what_two_services_cannot_share(
    system: System, first: dict[str, Any], second: dict[str, Any], shared: str, key: str
) -> None:
    for name, sections in (("one", first), ("two", second)):
        system.enable(f"midspan@{name}")
        system.configure(name, **sections)
    ((_, seen, cure),) = [finding for finding in system.findings() if finding[0] is Result.FAIL]
    assert seen.startswith(f"midspan@one and midspan@two have the same {shared}")
    assert cure == f"give each of them its own {key}"


@pytest.mark.parametrize(
    ("first", "second", "seen"),
    [
        (
            {"hub": {"open": {"listen": ["tls/0.0.0.0:7448"]}}},
            {"hub": {"listen": "tcp/127.0.0.1:7448"}},
            (
                "hub.listen of midspan@two (tcp/127.0.0.1:7448) uses the same port as hub.open.listen of midspan@one"
                " (tls/0.0.0.0:7448)"
            ),
        ),
        (
            {"metrics": {"enabled": True, "listen": "127.0.0.1:8480"}},
            {"web": {"enabled": True, "listen": "localhost:8480"}},
            (
                "web.listen of midspan@two (localhost:8480) uses the same port as metrics.listen of midspan@one"
                " (127.0.0.1:8480)"
            ),
        ),
        ({"web": {"enabled": True, "listen": "127.0.0.1:0"}}, {"web": {"enabled": True, "listen": "127.0.0.1:0"}}, ""),
        ({"hub": {"listen": "tcp/localhost:7447"}}, {"hub": {"listen": "tcp/127.0.0.1:7447"}}, ""),
    ],
)
def test_the_doctor_finds_ports_that_two_services_cannot_share(
    system: System, first: dict[str, Any], second: dict[str, Any], seen: str
) -> None:
    for name, sections in (("one", first), ("two", second)):
        system.enable(f"midspan@{name}")
        system.configure(name, name=name, **sections)
    fails = [finding[1:] for finding in system.findings() if finding[0] is Result.FAIL]
    assert fails == ([(seen, "change one of the ports")] if seen else [])


def test_the_doctor_names_broken_and_missing_configurations(system: System) -> None:
    for name in ("good", "broken", "missing"):
        system.enable(f"midspan@{name}")
    system.configure("good", name="good")
    broken = system.configure("broken", nmae="x", ros2={"domain": "seven"})
    fails = [(seen, cure) for result, seen, cure in system.findings() if result is Result.FAIL]
    assert [cure for _, cure in fails].count(f"midspan config check {broken}") == 2
    assert any(seen.startswith("midspan@missing: ") and "no such file" in seen for seen, _ in fails)


@pytest.fixture
def service(tmp_path: Path) -> Iterator[RobotDaemon]:
    """A daemon with the state folder that systemd assigns to its unit."""
    robot = RobotDaemon(tmp_path, navigation={}, modules={}, state=None)
    robot.env |= {"STATE_DIRECTORY": str(tmp_path / "state"), "XDG_STATE_HOME": str(tmp_path / "own")}
    yield robot
    robot.close()


def test_the_command_line_finds_the_state_of_a_service(
    service: RobotDaemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "own"))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setattr(units, "STATE", tmp_path / "state")
    config = load(service.file)
    assert daemon_state(config).life is Life.UNKNOWN
    service.run()
    state = until(lambda: (state := daemon_state(config)).life is Life.RUNNING and state, "the daemon is running", 40)
    assert service.daemon is not None
    assert state.pid == service.daemon.pid
    until(lambda: main(["status", "-c", str(service.file)]) == 0, "the router responds", 40)
    service.daemon.popen.kill()
    service.daemon.popen.wait(20)
    instance = Path("/etc/midspan/robot2.yaml")
    down = daemon_state(config, file=instance)
    assert (down.life, down.pid) == (Life.DOWN, service.daemon.pid)
    assert down.cure.startswith("start the daemon: 'systemctl start midspan@robot2'; 'journalctl -u midspan@robot2'")
    assert daemon_state(config.model_copy(update={"state": tmp_path / "none"})).life is Life.UNKNOWN


def test_two_daemons_share_the_state_folder_and_the_hub(tmp_path: Path) -> None:
    """Two instances of the template units do this; one router serves both, and the other router is on standby."""
    robots = [RobotDaemon(tmp_path / name, navigation={}, modules={}, state=None) for name in folders(tmp_path)]
    try:
        for robot, name in zip(robots, ("one", "two"), strict=True):
            robot.configure(
                name=name, navigation={}, modules={}, state=None, store={"enabled": True},
                hub={"listen": f"tcp/127.0.0.1:{robots[0].port}"},
            )  # fmt: skip
            assert robot.env is not None
            robot.env["STATE_DIRECTORY"] = str(tmp_path / "state")
            robot.midspan("worker", "router", "--control")
            robot.midspan("run", "--adopt", "router")
        until(lambda: has_both_daemons(robots[0]), "both daemons are on the hub with their stores", 60)
    finally:
        for robot in robots:
            robot.close()


def folders(root: Path) -> list[str]:
    for name in ("one", "two"):
        (root / name).mkdir()
    return ["one", "two"]


def has_both_daemons(robot: RobotDaemon) -> bool:
    """Return whether the status has both daemons, each with its store."""
    lines = robot.command("status").stdout.splitlines()
    return {"one", "two"} <= set(lines) and sum("store    running" in line for line in lines) == 2


def test_a_configured_state_folder_replaces_that_of_the_services(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    requests: list[Path | None] = []
    monkeypatch.setattr("bridge.doctor.daemon_state.ask_daemon", lambda config: requests.append(config.state))
    file = tmp_path / "midspan.yaml"
    file.write_text(json.dumps({"name": "a", "state": str(tmp_path / "mine")}))
    daemon_state(load(file))
    assert requests == [tmp_path / "mine"]
    requests.clear()
    file.write_text(json.dumps({"name": "a"}))
    monkeypatch.setenv("STATE_DIRECTORY", str(units.STATE))
    daemon_state(load(file))
    assert requests == [units.STATE]


BRIDGE = """
name: my_bridge
from_domain: 2
to_domain: 3
topics:
  chatter: {type: example_interfaces/msg/String}
"""


def test_the_files_of_an_imported_domain_bridge_are_instances(system: System, tmp_path: Path) -> None:
    """The setup is that of docs/start/migrating.md: two domains, two daemons, one template unit."""
    (tmp_path / "bridge_config.yaml").write_text(BRIDGE)
    assert main(["import", "domain_bridge", str(tmp_path / "bridge_config.yaml"), "-o", f"{tmp_path}/etc/midspan"]) == 0
    names = ["my_bridge_domain2", "my_bridge_domain3"]
    for name in names:
        system.enable(f"midspan@{name}")
    assert [(result, seen) for result, seen, _ in system.findings()] == [
        (Result.OK, f"midspan@{name} is the daemon my_bridge_{name[-1]} ({tmp_path}/etc/midspan/{name}.yaml)")
        for name in names
    ]


def test_the_configuration_in_the_docs_is_valid(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/operate/service.md").read_text()
    (text,) = re.findall(r"<<'END'\n(.*?)^END$", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "robot2.yaml").write_text(text)
    config = load(tmp_path / "robot2.yaml")
    assert (config.name, config.ros2.domain) == ("robot2", 2)

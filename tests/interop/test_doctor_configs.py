"""`midspan doctor` reports no problem for each documented configuration that runs with the programs that it names.

``default.yaml`` is left out: it changes no default (`tests.config.test_generated`), and neither do the workers'
sections of ``allow_list.yaml``, which is tested here.
If a program is not started yet, doctor names it, and no check fails. One roscore and one ROS domain serve the whole
file. Checks of the machine (compiler, shared memory, clock) are excluded: they do not depend on the configuration.
"""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.cli.main import main
from bridge.config.load import load
from bridge.daemon.query import Phase, ask_daemon
from bridge.doctor.checks import CHECKS
from tests.cli.conftest import Midspan
from tests.docs.test_documents import configurations
from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.ros1.network import ROS1_PYTHON, RosMaster, needs_ros1
from tests.peers.ros2.network import SHORT_LEASE, ros2_domain, ros2_environment, ros2_python
from tests.support.forks import DAEMON_AND_WORKERS
from tests.support.ports import free_port
from tests.support.process import DAEMON_SECONDS, Process
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Reader, Writer

pytestmark = [needs_ros1, pytest.mark.long]
ROOT = Path(__file__).parents[2]
CONFIGS, PEERS = ROOT / "configs", ROOT / "tests" / "peers"
APARTMENT = str(CONFIGS / "apartment" / "apartment.yaml")
MACHINE_CHECKS = {
    "kernels", "wheels", "compiler", "clock", "shm-users", "shm-size", "shm-litter", "shm-ports", "descriptors",
    "ros2-buffers",
}  # fmt: skip
VOLATILE = ("daemon", "types", "type-hash", "keys")
"""Checks whose result changes while a deployment starts."""

ALL_CHECKS = frozenset(check.id for check in CHECKS) - MACHINE_CHECKS
MOST = ALL_CHECKS - {"two-bridges"}
"""All checks but the one that takes 5 s, whose result is the same in most deployments."""

NO_WORKER = {Phase.OFF.value, Phase.UNAVAILABLE.value}
OF_MODULES = "modules"
SECONDS = 60.0

Config = dict[str, Any]


class Fresh:
    """A daemon that starts for the first time, with its own ports, folders, names and environment variables."""

    def __init__(self, config: Config, folder: Path, master: RosMaster, midspan: Callable[..., Any]) -> None:
        self.stack = contextlib.ExitStack()
        self._master, self._midspan = master, midspan
        address = Address("127.0.0.1", free_port())
        self.names = NameClient(address)
        settings = {"master": master.uri, "domain": ros2_domain(), "address": f"{address.host}:{address.port}"}
        config = {
            key: {k: settings.get(k, v) for k, v in value.items()} if key in ("ros1", "ros2", "yarp") else value
            for key, value in config.items()
            if value is not None
        }
        config |= {"state": str(folder / "state"), "store": in_configs(config.get("store", {}))}
        config["hub"] = {**config.get("hub", {}), "listen": f"tcp/127.0.0.1:{free_port()}"}
        self.file = folder / "midspan.yaml"
        self.file.write_text(yaml.safe_dump(config))
        (folder / "yarp.conf").write_text(f"{address.host} {address.port} yarp\n")  # as in docs/sides/yarp.md
        self.shell = {
            "ROS_MASTER_URI": master.uri,
            "ROS_DOMAIN_ID": str(ros2_domain()),
            "YARP_CONFIG_HOME": str(folder),
        }
        if config.get("yarp", {}).get("nameserver") == "site":
            self.stack.enter_context(NameServer(port=address.port, gc_seconds=0))
        run = [*MIDSPAN, "run", "--config", self.file]
        daemon = Process(run, os.environ | self.shell, imports=DAEMON_AND_WORKERS)
        self.stack.callback(daemon.stop, DAEMON_SECONDS)

    def ros1(self, script: str, *words: str) -> None:
        self.stack.enter_context(Process([ROS1_PYTHON, PEERS / script, *words], self._master.env))

    def ros2(self, script: str, *words: str) -> None:
        environment = {**ros2_environment(), **SHORT_LEASE}
        self.stack.enter_context(Process([ros2_python(), PEERS / script, *words], environment))

    def robot(self) -> None:
        """Open the ports of a robot on YARP."""
        for port in ("/cer/laser:o", "/baseControl/odometry:o"):
            self.stack.enter_context(Writer(port, naming=self.names))
        self.stack.enter_context(Reader("/baseControl/control:i", naming=self.names))

    def is_up(self) -> bool:
        """Return whether all enabled workers and hosted modules respond."""
        config = load(self.file)
        status = ask_daemon(config)
        if status is None:
            return False
        workers = {report.worker for report in status.workers if report.phase not in NO_WORKER}
        wanted = {f"{config.name}/{name}" for name in {*workers, *config.hosted} - {OF_MODULES}}
        answered = {f["seen"].partition(" ")[0] for f in self.doctor("daemon")}
        return all(any(node.startswith(name) for node in answered) for name in wanted)  # one zenoh node per dialect

    def doctor(self, *only: str) -> list[dict[str, str]]:
        """Return the findings of these checks."""
        options = [option for check in only for option in ("--only", check)]
        findings: list[dict[str, str]] = self._midspan(self, "doctor", "--json", *options).json()
        return findings

    def problems(self, *only: str) -> list[str]:
        """Return the warnings and failures."""
        return [
            f"{f['result']} {f['seen']} ({f['cure']})" for f in self.doctor(*only) if f["result"] in ("warn", "fail")
        ]

    def until_all_is_well(self, checks: Iterable[str] = MOST) -> None:
        self._until(lambda problems: not problems, checks)

    def until_it_waits(self, *patterns: str) -> None:
        """Wait until doctor reports exactly these warnings, one for each pattern, and no failure."""
        self._until(lambda problems: matches(problems, patterns), MOST)

    def _until(self, fits: Callable[[list[str]], bool], checks: Iterable[str]) -> None:
        """Wait for the expected problems, first of the volatile checks, then of all. Checks may time out under load."""
        problems: list[str] = []

        def expected(which: Iterable[str]) -> bool:
            problems[:] = self.problems(*which)
            return fits(problems)

        until(self.is_up, "all workers and modules respond", SECONDS, every=0.5)
        for which in (VOLATILE, checks):
            with contextlib.suppress(AssertionError):
                until(lambda which=which: expected(which), "doctor finds the expected problems", SECONDS, every=0.5)  # type: ignore[misc]
            assert fits(problems), problems


def in_configs(store: Config) -> Config:
    return {key: str(CONFIGS / value) if key in ("maps", "locations") else value for key, value in store.items()}


def matches(problems: list[str], patterns: tuple[str, ...]) -> bool:
    """Return whether the problems are warnings, one for each pattern."""
    return len(problems) == len(patterns) and all(
        any(line.startswith("warn ") and re.search(pattern, line) for line in problems) for pattern in patterns
    )


def from_file(name: str) -> Config:
    config = yaml.safe_load((CONFIGS / name).read_text())
    assert isinstance(config, dict)
    return config


def from_pages() -> Config:
    """Return the README's first configuration, with the sections from the pages about modules and the simulator."""
    blocks = [(page, yaml.safe_load(code)) for page, code in configurations()]
    (config,) = (block for page, block in blocks if page == "README.md")
    modules: Config = {}
    for page, block in blocks:
        if page in ("docs/sides/frames.md", "docs/navigation/maps.md"):
            modules |= block.get("modules", {})
        elif page == "docs/navigation/simulator.md" and "sim" in block:
            config |= {"sim": block["sim"]}
    assert set(modules) == {"transform_server", "map2d_server"}
    assert "sim" in config
    return {**config, "modules": modules}


@pytest.fixture(scope="module")
def master() -> Iterator[RosMaster]:
    with RosMaster() as started:
        yield started


@pytest.fixture
def fresh(
    master: RosMaster, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[[Config], Fresh]]:
    """Start deployments in folders with short paths, because pytest's own are too long for Unix sockets."""

    def midspan(site: Fresh, *words: str) -> Any:
        for name, value in site.shell.items():
            monkeypatch.setenv(name, value)
        return Midspan(site.file, capsys)(*words)

    with contextlib.ExitStack() as stack:

        def begin(config: Config) -> Fresh:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="midspan-t-")))
            site = Fresh(config, folder, master, midspan)
            stack.callback(site.stack.close)
            return site

        yield begin


Begin = Callable[[Config], Fresh]


@pytest.mark.parametrize(
    "name", ["allow_list.yaml", "demo.yaml", "zenoh_dialects.yaml", "navigation.yaml", "tables.yaml"]
)
def test_configurations_without_other_programs_have_no_problem(fresh: Begin, name: str) -> None:
    fresh(from_file(name)).until_all_is_well()


def test_the_configurations_of_the_pages_combined_have_no_problem(fresh: Begin) -> None:
    fresh(from_pages()).until_all_is_well(ALL_CHECKS)


def test_map_server_and_map2d_server_run_together_without_a_problem(fresh: Begin) -> None:
    site = fresh(from_file("ros_map_server.yaml"))
    site.until_it_waits(
        "localization_server waits: waiting for a map on /map",
        "robot_path_planner waits: waiting for a map",
        "robot_goto waits: .*waiting for a map",
    )
    site.ros1("ros1/map_server.py", APARTMENT)
    site.until_all_is_well()
    seen = lambda: str([finding["seen"] for finding in site.doctor("types")])  # noqa: E731
    until(lambda: "/change_map, /static_map: the map server" in seen(), "doctor names the services", SECONDS, every=0.5)


def test_a_robot_on_yarp_has_no_problem(fresh: Begin) -> None:
    site = fresh(from_file("yarp_robot.yaml"))
    site.robot()
    site.until_all_is_well()


def test_move_base_drives_a_robot_on_yarp_without_a_problem(fresh: Begin) -> None:
    site = fresh(from_file("yarp_robot_move_base.yaml"))
    site.until_it_waits(
        "gateway waits: the planner move_base is not available: no node serves its action /move_base on ROS 1 .start",
        "waiting for /baseControl/control:i, to connect it to",
    )
    site.robot()
    site.ros1("ros1/map_server.py", APARTMENT)
    site.ros1("ros1/amcl.py")
    site.ros1("ros1/move_base.py", "2.0", "5.0")
    site.until_all_is_well(ALL_CHECKS)


def test_the_nav2_configuration_passes_once_nav2_runs(fresh: Begin) -> None:
    site = fresh(from_file("nav2.yaml"))
    site.until_it_waits(
        "gateway waits: the planner nav2 is not available: no node serves its action /navigate_to_pose on ROS 2"
    )
    site.ros2("ros2/nav2.py", "2.0", "5.0")
    site.until_all_is_well()


def test_a_robot_and_its_operator_have_no_problem(fresh: Begin, tmp_path: Path) -> None:
    keys, endpoint = tmp_path / "keys", f"tls/127.0.0.1:{free_port()}"
    for name in ("robot1", "operator1"):
        assert main(["keys", "make", name, "127.0.0.1", "--folder", str(keys)]) == 0
    robot, operator = from_file("robot.yaml"), from_file("operator.yaml")
    robot["hub"]["open"] |= {"listen": [endpoint], "keys": str(keys)}
    operator["hub"]["open"] |= {"connect": [endpoint], "keys": str(keys)}
    station = fresh(operator)
    station.until_it_waits(rf"hub\.open\.connect {endpoint}: not answering: nothing listens")
    robot_site = fresh(robot)
    robot_site.until_all_is_well()
    until(lambda: "robot1/ros1" in str(station.doctor("daemon")), "the operator sees the robot", SECONDS, every=0.5)
    station.until_all_is_well(ALL_CHECKS)

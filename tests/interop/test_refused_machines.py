"""Two daemons whose certificates are from different authorities: each reports the refusal once, and clears it later."""

from __future__ import annotations

import contextlib
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.security.certificates import Authority
from tests.peers.daemon.midspan import MIDSPAN, verb_module
from tests.support.forks import COMMAND, DAEMON_AND_WORKERS
from tests.support.ports import free_port
from tests.support.process import DAEMON_SECONDS, Process, run_forked
from tests.support.wait import until

OFF = {"enabled": False}


class Daemon:
    """`midspan run`, or only the router's worker, as systemd runs it."""

    def __init__(self, folder: Path, name: str, keys: Path, run: list[str], **opened: Any) -> None:
        self.name = name
        self.file = folder / f"{name}.yaml"
        sides = dict.fromkeys(("ros1", "ros2", "yarp"), OFF)
        hub = {"listen": f"tcp/127.0.0.1:{free_port()}", "open": {"keys": str(keys), **opened}}
        self.file.write_text(json.dumps({"name": name, "state": str(folder / f"state-{name}"), **sides, "hub": hub}))
        self.process = Process([*MIDSPAN, *run, "--config", self.file], imports=DAEMON_AND_WORKERS)

    def midspan(self, *words: str) -> str:
        command = [*MIDSPAN, *words, "--config", str(self.file)]
        return run_forked(command, imports=[*COMMAND, verb_module(words[0])]).stdout

    def endpoint(self) -> dict[str, Any]:
        documents = json.loads(self.midspan("status", "--json") or "[]")
        return next(
            (item["endpoints"][0] for item in documents if item.get("worker") == "router" and item["endpoints"]), {}
        )

    def lines(self, text: str) -> list[str]:
        return [line for line in self.process.output().splitlines() if text in line]


def until_printed(daemon: Daemon, *texts: str) -> None:
    """Wait until ``midspan status`` prints these texts."""

    def printed() -> bool:
        status = daemon.midspan("status")
        return all(text in status for text in texts)

    until(printed, f"the status of {daemon.name} contains {texts}")


@pytest.fixture
def short() -> Iterator[Path]:
    """A folder with a path short enough for Unix sockets."""
    with tempfile.TemporaryDirectory(prefix="midspan-") as folder:
        yield Path(folder)


@pytest.mark.timeout(300)  # ten commands, each of which takes up to ten seconds on a busy machine
@pytest.mark.parametrize(
    "run",
    [pytest.param(["run"], id="daemon"), pytest.param(["worker", "router"], id="service", marks=pytest.mark.thorough)],
)
def test_both_ends_report_a_foreign_authority(short: Path, run: list[str]) -> None:
    for fleet in ("a", "b"):
        Authority(short / fleet).make()
        for name in ("robot1", "operator1"):
            Authority(short / fleet).issue(name, ["127.0.0.1"])
    place = f"tls/127.0.0.1:{free_port()}"
    robot = Daemon(short, "robot1", short / "a", run, listen=[place])
    with contextlib.ExitStack() as running:
        running.callback(robot.process.stop, DAEMON_SECONDS)
        # a router that starts before the other one listens may log that nothing answers
        until(lambda: robot.endpoint().get("state") == "listening", "the robot listens", every=0.2)
        operator = Daemon(short, "operator1", short / "b", run, connect=[place])
        running.callback(operator.process.stop, DAEMON_SECONDS)
        until(
            lambda: operator.lines(f"hub.open.connect {place}: refused: the other machine's certificate"),
            "the operator logs the refusal",
        )
        until(lambda: robot.lines(f"hub.open.listen {place}: a machine"), "the robot logs the refusal")
        endpoint: dict[str, Any] = {}

        def refused() -> bool:
            endpoint.update(robot.endpoint())
            return endpoint.get("state") == "refused"

        until(refused, "the robot's status shows the refusal", every=0.2)
        assert endpoint["cure"]
        # a busy router may not respond to a command in time
        until(lambda: operator.endpoint().get("state") == "refused", "the operator's status shows the refusal")
        until_printed(robot, f"hub.open.listen {place} refused for ", "from another authority")
        until_printed(operator, f"hub.open.connect {place} refused for ")
        assert "FAIL" in operator.midspan("doctor", "--only", "keys")
        assert "from another authority" in robot.midspan("doctor", "--only", "keys")
        assert len(operator.lines("hub.open.connect")) == 1
        assert len(robot.lines("hub.open.listen")) <= 2, "more than one line for each direction of the refusal"
        operator.process.stop(DAEMON_SECONDS)
        until(lambda: robot.lines("machines are no longer refused"), "the robot clears the report")
        until(lambda: robot.endpoint().get("state") == "listening", "the robot's status shows no refusal")
        joined = Daemon(short, "operator1", short / "a", run, connect=[place])
        running.callback(joined.process.stop, DAEMON_SECONDS)
        until(lambda: joined.lines(f"hub.open.connect {place}: connected to robot1"), "the operator joins")
        until_printed(joined, f"hub.open.connect {place} connected to robot1 for ")
        assert f"{place}: TLS with robot1 succeeds, and the router reports connected" in joined.midspan(
            "doctor", "--only", "keys"
        )

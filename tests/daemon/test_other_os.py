"""The whole daemon as on Windows and macOS: it and all its workers run with everything hidden that these lack.

`tests.support.other_os` hides it: in the daemon, in each worker, and in the commands.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import psutil
import pytest
import yaml

from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.peers.zenoh.programs import Ros2ddsBridge
from tests.support.hidden import as_on, is_windows_name
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.rosbags_messages import Messages
from tests.support.wait import until

MIDSPAN = [sys.executable, "-m", "bridge.cli.main"]
STRING = "std_msgs/String"


class OtherOs:
    """A daemon as on another system, with the programs on its sides."""

    def __init__(self, system: Literal["windows", "macos"], folder: Path) -> None:
        self.system, self.env = system, as_on(system)
        self.folder, self.file = folder, folder / "midspan.yaml"
        self.names = Names()
        self.hub, self.web = f"tcp/127.0.0.1:{free_port()}", free_port()
        self.configure()
        self.process = Process([*MIDSPAN, "run", "--config", self.file], self.env)

    def configure(self, **sections: Any) -> None:
        """Write the configuration file. The daemon's name is not a file name on Windows."""
        config = {
            "name": "CON",
            "state": str(self.folder / "state"),
            "hub": {"listen": self.hub, "shared_memory": False},
            "ros1": {"enabled": False},
            "ros2": {"enabled": False},
            "yarp": {"nameserver": "site", "address": self.names.endpoint, "poll": 0.1},
            "zenoh": {"router": self.hub, "dialects": [{"dialect": "ros2dds"}]},
            "web": {"enabled": True, "listen": f"127.0.0.1:{self.web}"},
            "modules": {"transform_server": {"enabled": True}},
        }
        self.file.write_text(yaml.safe_dump({**config, **sections}))

    def midspan(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a command."""
        command = [*MIDSPAN, *words, "--config", str(self.file)]
        return subprocess.run(command, env=self.env, capture_output=True, text=True, timeout=100, check=False)

    def wait_for(self, text: str, count: int = 1) -> None:
        """Wait for a text in the daemon's log."""

        def logged() -> bool:
            assert self.process.popen.poll() is None, self.process.output()
            return self.process.output().count(text) >= count

        until(logged, f"{count}x {text!r}", 60)

    def pids(self, worker: str) -> list[int]:
        """Return the processes of all starts of a worker."""
        return [int(pid) for pid in re.findall(rf" {worker} started as process (\d+)", self.process.output())]

    def close(self) -> None:
        """Stop everything."""
        self.process.stop()
        self.names.stop()


@pytest.fixture(scope="module", params=["windows", "macos"])
def other(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[OtherOs]:
    """One daemon for each system, which the tests use in their order."""
    other = OtherOs(request.param, tmp_path_factory.mktemp("other os"))
    yield other
    other.close()


@pytest.mark.timeout(240)
def test_the_daemon_works(other: OtherOs) -> None:
    """One test, since its parts depend on each other: messages cross, reload, restart, stop."""
    other.wait_for("ready: ")
    for worker in ("router", "yarp", "zenoh", "modules", "web"):
        other.wait_for(f"{worker}: running")
    crosses(other, "before")
    reloads(other)
    restarts_a_killed_worker(other)
    crosses(other, "after")
    stops(other)


def crosses(other: OtherOs, word: str) -> None:
    """A YARP program's message reaches zenoh."""
    program = YarpProgram(other.names, f"/{word}", Definitions(()))
    bridge = Ros2ddsBridge(other.hub, Messages(ros1=False))
    try:
        publisher, subscription = program.advertise(f"/{word}", STRING), bridge.subscribe(f"/{word}", STRING)

        def arrived() -> bool:
            program.publish(publisher, {"data": word})
            return bridge.wait(subscription, 1, 0.2) != []

        until(arrived, "zenoh receives it", 40, every=0.1)
        assert bridge.wait(subscription, 1)[0] == {"data": word}
    finally:
        program.stop()
        bridge.stop()


def reloads(other: OtherOs) -> None:
    """`midspan reload` applies a change, and reports a mistake."""
    other.configure(routing={"rules": [{"topic": "/private/**", "deny": True}]})
    done = other.midspan("reload")
    assert (done.returncode, done.stdout) == (0, "the daemon CON has loaded its configuration\n"), done.stderr
    other.wait_for("configuration applied", 2)
    other.configure(state="elsewhere")
    done = other.midspan("reload")
    assert done.returncode == 1
    assert "needs a restart of the daemon" in other.process.output() or "no daemon named CON runs" in done.stderr
    other.configure()


def restarts_a_killed_worker(other: OtherOs) -> None:
    """A killed worker is started again, once its lock is free."""
    (first,) = other.pids("yarp")
    psutil.Process(first).kill()
    until(lambda: len(other.pids("yarp")) == 2, "it is started again", 40)
    other.wait_for("yarp: running", 2)


def stops(other: OtherOs) -> None:
    """Ctrl-C stops all workers in order, and leaves no socket."""
    workers = [other.pids(worker)[-1] for worker in ("router", "yarp", "zenoh", "modules", "web")]
    os.kill(other.process.pid, signal.SIGINT)  # Ctrl-C, which every system has
    assert other.process.popen.wait(30) == 0, other.process.output()
    output = other.process.output()
    assert [pid for pid in workers if psutil.pid_exists(pid)] == []
    assert re.search(r"killing process|Traceback|did not stop", output.replace("yarp killed by SIGKILL", "")) is None, (
        output
    )
    names = [path.name for path in (other.folder / "state").rglob("*")]
    assert [name for name in names if name.endswith(".sock")] == []
    if other.system == "windows":
        assert "%43ON.daemon.lock" in names
        assert [name for name in names if not is_windows_name(name)] == []

"""The whole daemon on another system: on Linux with everything hidden that Windows and macOS lack, or on that system.

`tests.support.other_os` hides it from the daemon, each worker and the commands. With ``MIDSPAN_TEST_SYSTEMS=here``
nothing is hidden, as `.github/workflows/every_os.yml` runs it on each system, with the installed wheel.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

import psutil
import pytest
import yaml

from bridge.adapters.ros1.program import Ros1Program
from tests.contract.plainside import PlainPeer
from tests.contract.side import PeerLike
from tests.peers.hub.recorded_robot import read
from tests.peers.peer import Peer
from tests.peers.ros1.network import ROS1_PEER, ROS1_PYTHON, ros1_environment
from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.peers.zenoh.programs import Ros2ddsBridge
from tests.support.hidden import as_on, is_windows_name
from tests.support.missing import has_ros1
from tests.support.ports import free_port
from tests.support.rosbags_messages import Messages
from tests.support.wait import SLOWNESS, until

SYSTEMS = os.environ.get("MIDSPAN_TEST_SYSTEMS", "windows,macos").split(",")
MIDSPAN = [sys.executable, "-P", "-m", "bridge.cli.main"]
STRING = "std_msgs/String"
WORKERS = ("router", "ros1_master", "ros1", "yarp", "zenoh", "modules", "web", "record")


MISSING = """
from pathlib import Path
print([path for path in ("/proc", "/dev/shm", "/sys", "/run", "/etc", "/dev/fd") if not Path(path).exists()])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="hides folders of Linux")
@pytest.mark.parametrize(
    ("system", "missing"),
    [("macos", ["/proc", "/dev/shm", "/sys", "/run"]),
     ("windows", ["/proc", "/dev/shm", "/sys", "/run", "/etc", "/dev/fd"])],
)  # fmt: skip
def test_folders_of_linux_are_hidden(system: str, missing: list[str]) -> None:
    program = f"exec({MISSING!r}, {{'__package__': 'bridge'}})"
    done = subprocess.run(
        [sys.executable, "-c", program], env=as_on(system), capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str(missing)


class OtherOs:
    """A daemon as on another system, and programs on its sides."""

    def __init__(self, system: str, folder: Path, log: IO[bytes]) -> None:
        self.system = system
        self.env = as_on(system) if system in ("windows", "macos") else dict(os.environ)
        self.folder, self.file, self.log = folder, folder / "midspan.yaml", Path(log.name)
        self.names = Names()
        self.hub, self.web, self.ros1 = f"tcp/127.0.0.1:{free_port()}", free_port(), free_port()
        self.configure()
        self.process = subprocess.Popen(
            [*MIDSPAN, "run", "--config", str(self.file)],
            env=self.env, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )  # fmt: skip

    def configure(self, **sections: Any) -> None:
        """Write the configuration file. The daemon's name is not a file name on Windows."""
        config = {
            "name": "CON",
            "state": str(self.folder / "state"),
            "hub": {"listen": self.hub, "shared_memory": False},
            "ros1": {"master": "embedded", "listen": f"127.0.0.1:{self.ros1}", "poll": 0.1},
            "ros2": {"enabled": False},
            "yarp": {"nameserver": "site", "address": self.names.endpoint, "poll": 0.1},
            "zenoh": {"router": self.hub, "dialects": [{"dialect": "ros2dds"}]},
            "web": {"enabled": True, "listen": f"127.0.0.1:{self.web}"},
            "modules": {"transform_server": {"enabled": True}},
            "record": {"enabled": True, "topics": ["/recorded"]},
        }
        self.file.write_text(yaml.safe_dump({**config, **sections}), encoding="utf-8")

    def midspan(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a command."""
        command = [*MIDSPAN, *words, "--config", str(self.file)]
        return subprocess.run(
            command, env=self.env, capture_output=True, text=True, timeout=100 * SLOWNESS, check=False
        )

    def output(self) -> str:
        """Return the daemon's log."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def wait_for(self, text: str, count: int = 1) -> None:
        """Wait for a text in the daemon's log."""

        def logged() -> bool:
            assert self.process.poll() is None, self.output()
            return self.output().count(text) >= count

        until(logged, f"{count}x {text!r}", 60)

    def pids(self, worker: str) -> list[int]:
        """Return the processes of all starts of a worker."""
        return [int(pid) for pid in re.findall(rf" {worker} started as process (\d+)", self.output())]

    def ros1_program(self, name: str) -> PeerLike:
        """Start a rospy program; on systems without ROS 1, one on Midspan's own node."""
        uri = f"http://127.0.0.1:{self.ros1}/"
        if has_ros1():
            env = {**ros1_environment(uri), "ROS_HOME": str(self.folder), "ROS_LOG_DIR": str(self.folder / "log")}
            return Peer(ROS1_PEER, ROS1_PYTHON, env, name)
        return PlainPeer(Ros1Program(name, master=uri), uri)

    def interrupt(self) -> None:
        """Send Ctrl-C, or Ctrl-Break on Windows, which cannot send Ctrl-C to another process group."""
        self.process.send_signal(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT))

    def close(self) -> None:
        """Stop everything, including what a failed test left running."""
        if self.process.poll() is None:
            self.interrupt()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(10 * SLOWNESS)
            self.process.kill()
            self.process.wait()
        for pid in [*self.pids("router")[-1:], *self.pids("ros1_master")[-1:]]:
            with contextlib.suppress(psutil.Error):
                psutil.Process(pid).kill()
        self.names.stop()


@pytest.fixture(scope="module", params=SYSTEMS)
def other(request: pytest.FixtureRequest) -> Iterator[OtherOs]:
    """A daemon for each tested system."""
    # pytest's folder is too long for a socket's path, and on macOS, so is the default of tempfile
    short = "/tmp" if os.name == "posix" else None
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="midspan other os ", dir=short)))
        log = stack.enter_context((folder / "daemon.log").open("wb"))
        other = OtherOs(request.param, folder, log)
        yield other
        if request.session.testsfailed:
            print(other.output())
        other.close()


@pytest.mark.timeout(240)
def test_the_daemon_works(other: OtherOs) -> None:
    """This is one test because its parts depend on each other."""
    other.wait_for("ready: ")
    for worker in WORKERS:
        other.wait_for(f"{worker}: running")
    assert_crosses(other, "before")
    assert_records(other)
    assert_reloads(other)
    assert_restarts_a_killed_worker(other)
    assert_crosses(other, "after")
    assert_stops(other)


def assert_crosses(other: OtherOs, word: str) -> None:
    """Messages of a YARP, a zenoh and a ROS 1 program each reach the other two."""
    programs: dict[str, PeerLike] = {
        "YARP": YarpProgram(other.names.client, f"/{word}", Definitions(())),
        "zenoh": Ros2ddsBridge(other.hub, Messages(ros1=False)),
        "ROS 1": other.ros1_program(word),
    }
    try:
        for name, program in programs.items():
            topic = f"/{word}/{name.replace(' ', '').lower()}"
            publisher = program.advertise(topic, STRING)
            for receiver in programs.keys() - {name}:
                subscription = programs[receiver].subscribe(topic, STRING)

                def arrived(receiver: PeerLike = programs[receiver], subscription: int = subscription) -> bool:
                    program.publish(publisher, {"data": word})  # noqa: B023  called in this iteration
                    return receiver.wait(subscription, 1, 0.2) != []

                until(arrived, f"{receiver} receives messages of {name}", 40, every=0.1)
                assert programs[receiver].wait(subscription, 1)[0] == {"data": word}
    finally:
        for program in programs.values():
            program.stop()


def assert_records(other: OtherOs) -> None:
    """The daemon's recorder writes a message of a YARP program, with its bytes unchanged."""
    text = "recorded\n" * 10
    program = YarpProgram(other.names.client, "/recorded", Definitions(()))
    try:
        publisher = program.advertise("/recorded", STRING)

        def recorded() -> bool:
            program.publish(publisher, {"data": text})
            return any(text in read(file).texts("/recorded") for file in (other.folder / "state").rglob("*.mcap"))

        until(recorded, "the message is in the recording", 40, every=0.2)
    finally:
        program.stop()


def assert_reloads(other: OtherOs) -> None:
    """`midspan reload` applies a change, and reports a mistake."""
    other.configure(routing={"rules": [{"topic": "/private/**", "deny": True}]})
    done = other.midspan("reload")
    assert (done.returncode, done.stdout) == (0, "the daemon CON has loaded its configuration\n"), done.stderr
    for worker in ("yarp", "zenoh"):
        other.wait_for(f"{worker}: configuration applied")
    other.configure(name="OTHER")
    done = other.midspan("reload")
    assert done.returncode == 1
    assert "no daemon named OTHER runs" in done.stderr
    other.configure()


def assert_restarts_a_killed_worker(other: OtherOs) -> None:
    """A killed worker is started again, once its lock is free."""
    (first,) = other.pids("yarp")
    psutil.Process(first).kill()
    until(lambda: len(other.pids("yarp")) == 2, "the worker is started again", 40)
    other.wait_for("yarp: running", 2)


def assert_stops(other: OtherOs) -> None:
    """Ctrl-C stops all workers by request, and leaves no socket."""
    workers = [other.pids(worker)[-1] for worker in WORKERS]
    other.interrupt()
    assert other.process.wait(30 * SLOWNESS) == 0
    assert [pid for pid in workers if psutil.pid_exists(pid)] == []
    stops = re.findall(r" (\w+): stopping: (?:requested by the daemon|SIGTERM)", other.output())
    assert set(WORKERS) <= set(stops), "every worker was asked to stop, and none was just killed"
    assert "Traceback" not in other.output()
    names = [path.name for path in (other.folder / "state").rglob("*")]
    assert [name for name in names if name.endswith(".sock")] == []
    if other.system == "windows" or sys.platform == "win32":
        assert "%43ON.daemon.lock" in names
        assert [name for name in names if not is_windows_name(name)] == []

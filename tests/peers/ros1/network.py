"""A ROS 1 network for a test: a master on a free port, and the environment of real ROS 1 programs."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from xmlrpc.client import ServerProxy

import psutil

from tests.peers.peer import Peer
from tests.support.missing import ROS1, need, needs
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

ROS1_PEER = Path(__file__).with_name("peer.py")
"""The peer program of `tests.peers.peer` for ROS 1; runs on the system's Python."""

ROS1_CORE = Path(__file__).with_name("core.py")

EMBEDDED_CORE = Path(__file__).with_name("embedded_core.py")

EMBEDDED = os.environ.get("MIDSPAN_TEST_MASTER", "roscore") == "embedded"
"""Whether tests that do not name a master use Midspan's own; see ``make test-embedded-master``."""

ROS1_PYTHON = Path("/usr/bin/python3")

needs_ros1 = needs(ROS1)


def ros1_environment(master: str = "", environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return an environment for real ROS 1 programs: the system's Python packages and libraries, and only loopback."""
    unset = ("PYTHONPATH", "PYTHONHOME", "LD_LIBRARY_PATH", "VIRTUAL_ENV", "ROS_HOSTNAME", "AMENT_PREFIX_PATH")
    env = {k: v for k, v in environ.items() if k not in unset and not k.startswith("ROS_")}
    env["ROS_IP"] = "127.0.0.1"
    env["PATH"] = f"/usr/bin:/bin:{env.get('PATH', '')}"
    if master:
        env["ROS_MASTER_URI"] = master
    return env


class RosMaster:
    """A roscore (master, parameters, rosout) on its own port, which stays the same when it is restarted.

    The programs run without roscore's launcher, unless ``command`` requests the real command. ``embedded`` selects
    Midspan's own master instead, which keeps its state over a restart. ``address`` is the host in its URI and in those
    of its nodes.
    """

    def __init__(
        self, *, command: bool = False, embedded: bool = EMBEDDED, address: str = "127.0.0.1"
    ) -> None:  # fmt: skip
        need(ROS1)
        self.port = free_port()
        self.uri = f"http://{f'[{address}]' if ':' in address else address}:{self.port}/"
        self._folder = tempfile.mkdtemp(prefix="midspan-test-ros1-")
        self.env = {
            **ros1_environment(self.uri),
            "ROS_IP": address,
            "ROS_HOME": self._folder,
            "ROS_LOG_DIR": f"{self._folder}/log",
        }
        self.embedded = embedded and not command
        self._program: list[str | Path] = [ROS1_PYTHON, ROS1_CORE]
        if command:
            self._program = [ROS1_PYTHON, "/usr/bin/roscore", "-p"]
        elif self.embedded:
            self._program = [sys.executable, EMBEDDED_CORE, f"{self._folder}/master.json", address]
        self._process: Process | None = None

    def start(self, *, forget: bool = False) -> None:
        """Start roscore, and wait until it responds; with ``forget``, discard what Midspan's master has saved."""
        if forget:
            Path(self._folder, "master.json").unlink(missing_ok=True)
        self._process = Process([*self._program, str(self.port)], self.env)
        until(lambda: self._ready(), "roscore replies", 30.0)

    def stop(self) -> None:
        """Stop roscore; its nodes keep running."""
        if self._process is not None:
            self._process.stop()
            self._process = None

    def signal(self, number: int) -> None:
        """Send a signal to roscore."""
        assert self._process is not None
        self._process.signal(number)

    def kill(self) -> None:
        """Kill roscore, because its command takes a second to stop by itself; its nodes keep running."""
        if self._process is not None:
            # the command's master and rosout have their own sessions
            parts = psutil.Process(self._process.pid).children() if self._process.popen.poll() is None else []
            self._process.stop(0)
            for part in parts:
                with contextlib.suppress(psutil.NoSuchProcess):  # it may have exited with the command
                    part.kill()
            self._process = None

    def close(self) -> None:
        """Kill roscore, and remove its files."""
        self.kill()
        shutil.rmtree(self._folder, ignore_errors=True)

    def call(self, method: str, *params: Any) -> Any:
        """Call the master's API; return the value in the response, or None if the call failed."""
        with ServerProxy(self.uri) as proxy:
            code, _, value = getattr(proxy, method)("/test", *params)
        return value if code == 1 else None

    def state(self) -> dict[str, dict[str, list[str]]]:
        """Return the master's state: publishers, subscribers and services, each by name with its nodes."""
        kinds = self.call("getSystemState")
        names = ("publishers", "subscribers", "services")
        return {n: {name: sorted(nodes) for name, nodes in kind} for n, kind in zip(names, kinds, strict=True)}

    def nodes(self) -> set[str]:
        """Return all nodes that are registered with the master."""
        return {n for kind in self.state().values() for nodes in kind.values() for n in nodes}

    def parameters(self) -> set[str]:
        """Return the names of all parameters."""
        return set(self.call("getParamNames"))

    def peer(self, name: str = "peer") -> Peer:
        """Start a real rospy program on this network, with a node of this name."""
        return Peer(ROS1_PEER, ROS1_PYTHON, self.env, name)

    def _ready(self) -> bool:
        """Return whether roscore responds, and rosout has made all of its registrations, which come one by one."""
        try:
            if not self.call("getParam", "/run_id"):
                return False
            state = self.state()
        except OSError:
            return False
        links = (state["publishers"].get("/rosout_agg", []), state["subscribers"].get("/rosout", []))
        return all("/rosout" in nodes for nodes in links)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

"""The contract suite's interface to a side: its network, real programs on it, and the bridge's worker.

An adapter joins the suite with one subclass here and one line in ``conftest.py``.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol

from bridge.config.model import Config
from bridge.daemon.heartbeat import DUMP_STACKS
from tests.peers.peer import stop_all
from tests.support.hidden import as_on
from tests.support.process import Process
from tests.support.processor_share import ProcessorShare
from tests.support.wait import until

CUSTOM_FOLDER = Path(__file__).parent / "msgs"
OWN_FOLDER = Path(__file__).parent / "own"
"""The folder of an empty message, which the bridge needs unless the side's protocol describes empty types fully."""

PEER_FOLDERS = (CUSTOM_FOLDER, OWN_FOLDER)
IMPORTS = ("bridge.cli.daemon.run", "bridge.daemon.worker_main", "bridge.adapters.worker")
"""The modules that a worker of each side imports."""

CUSTOM_TYPES = ("contract_msgs/Thing", "octomap_msgs/Octomap", "own_msgs/Ping")


class PeerLike(Protocol):
    """A program on the side; see ``tests.peers.peer``."""

    def advertise(self, topic: str, type_: str, **qos: Any) -> int: ...
    def subscribe(self, topic: str, type_: str, **qos: Any) -> int: ...
    def publish(self, endpoint: int, message: dict[str, Any]) -> None: ...
    def wait(self, endpoint: int, count: int, seconds: float = 10.0) -> list[dict[str, Any]]: ...
    def drop(self, endpoint: int) -> None: ...
    def graph(self) -> dict[str, Any]: ...
    def ask(self, do: str, **params: Any) -> dict[str, Any]: ...
    def stop(self, seconds: float = 6.0) -> int: ...


class Bridge(Protocol):
    """A running worker of the side under test."""

    def reload(self, config: Config) -> None: ...
    def stop(self) -> None: ...
    def kill(self) -> None: ...


class Side(ABC):
    """One side under test."""

    name: ClassVar[str]
    has_custom_types: ClassVar[bool] = True
    can_restart_network: ClassVar[bool] = True
    tells_latching: ClassVar[bool] = True
    has_services: ClassVar[bool] = False
    tells_errors: ClassVar[bool] = True
    reports_death: ClassVar[bool] = True
    lists_subscribers: ClassVar[bool] = True
    tells_empty_types: ClassVar[bool] = False

    def __init__(self) -> None:
        self._names = itertools.count(1)
        self._open: list[Any] = []

    @abstractmethod
    def peer(self) -> PeerLike:
        """Start a new real program on the side."""

    def mortal(self) -> PeerLike:
        """Start a program that the test will kill, and whose exit the side notices without delay."""
        return self.peer()

    @abstractmethod
    def bridge(self, config: Config) -> Bridge:
        """Start the bridge's worker for this side, and return when it has joined."""

    @abstractmethod
    def restart_network(self) -> None:
        """Kill and restart the network, which removes the programs on it."""

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """Return the configuration's sections for this side, by name."""

    def close(self) -> None:
        """Stop everything that was started."""
        stop_all(self._open)
        self._open.clear()


class WorkerProcess:
    """``midspan worker SIDE --supervised`` under the test's control."""

    def __init__(
        self, side: str, config: Config, env: Mapping[str, str], states: Collection[str] = ("running",), *,
        any_os: bool = False, edge: str | None = None,
    ) -> None:  # fmt: skip
        words = ["worker", side, "--supervised"]
        imports = [*IMPORTS, edge or f"bridge.adapters.{side}.edge"]
        if any_os:  # a worker without the features that Windows lacks
            env = as_on("windows", env)
            config.state.mkdir(parents=True, exist_ok=True)  # the daemon's task; the worker locks a file there
        elif "LD_PRELOAD" in env:  # a fork of a process that started without the library does not load it
            imports = []
        self.process = Process([sys.executable, "-m", "bridge.cli.main", *words], env, pipes=True, imports=imports)
        self._send({"config": json.loads(config.model_dump_json(by_alias=True))})
        until(lambda: self.beat()["state"] in states, f"{side} worker runs", 20, every=0)

    def _send(self, line: dict[str, Any]) -> None:
        pipe = self.process.popen.stdin
        assert pipe is not None
        pipe.write(json.dumps(line) + "\n")
        pipe.flush()

    def beat(self) -> dict[str, Any]:
        """Return the worker's next heartbeat."""
        pipe = self.process.popen.stdout
        assert pipe is not None
        while True:
            line = pipe.readline()
            assert line, f"worker ended: {self.process.output()[-4000:]}"
            text: dict[str, Any] = json.loads(line)
            assert "restart" not in text, text
            if "busy" not in text:
                return text

    def reload(self, config: Config) -> None:
        """Send another configuration."""
        self._send({"config": json.loads(config.model_dump_json(by_alias=True))})

    def stop(self) -> None:
        """Stop the worker as the supervisor does."""
        if self.process.popen.poll() is None:
            share = ProcessorShare()
            self._send({"stop": True})
            try:
                self._await_exit(5.0, share)
            except subprocess.TimeoutExpired:
                raise AssertionError("worker did not stop in 20 s: " + self._stacks()) from None
            finally:
                self.process.stop()

    def _await_exit(self, seconds: float, share: ProcessorShare) -> None:
        """Wait for the exit, and longer if other programs left few processors; raises `subprocess.TimeoutExpired`."""
        try:
            self.process.popen.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.popen.wait(seconds / share.least() - seconds)

    def _stacks(self) -> str:
        """Return the end of the worker's output, with the stacks of its threads unless it ends now."""
        if DUMP_STACKS is not None:
            self.process.signal(DUMP_STACKS)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.popen.wait(1)
        return self.process.output()[-12_000:]

    def kill(self) -> None:
        """Kill the worker with SIGKILL."""
        self.process.signal(9)
        self.process.popen.wait()
        self.process.stop()

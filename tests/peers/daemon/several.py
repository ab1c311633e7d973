"""Several daemons, each with its own state folder, name and networks, or with shared networks."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import psutil
import yaml

from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from tests.peers.daemon.deployment import ANSWER_SECONDS
from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.peer import Peer
from tests.peers.ros1.network import RosMaster
from tests.peers.ros2.network import ROS2_PEER, new_domain, ros2_environment, ros2_python
from tests.support.forks import DAEMON_AND_WORKERS
from tests.support.lane import LANE
from tests.support.ports import free_port
from tests.support.process import DAEMON_SECONDS, Process
from tests.support.wait import until

STRING = "std_msgs/String"


class Network(Protocol):
    """A network outside Midspan."""

    side: str

    def settings(self) -> dict[str, Any]:
        """Return the side's section of a daemon's configuration."""

    def program(self, name: str) -> Peer:
        """Start a native program on the network."""

    def close(self) -> None:
        """Stop the network."""


class Ros1Network:
    """A separate roscore."""

    side = "ros1"

    def __init__(self) -> None:
        self._master = RosMaster()
        self._master.start()

    def settings(self) -> dict[str, Any]:
        return {"master": self._master.uri}

    def program(self, name: str) -> Peer:
        return self._master.peer(name)

    def close(self) -> None:
        self._master.close()


class Ros2Network:
    """A separate DDS domain."""

    side = "ros2"

    def __init__(self) -> None:
        self._domain = new_domain()

    def settings(self) -> dict[str, Any]:
        return {"domain": self._domain}

    def program(self, name: str) -> Peer:
        env = ros2_environment() | {"ROS_DOMAIN_ID": str(self._domain)}
        return Peer(ROS2_PEER, ros2_python(), env, name)

    def close(self) -> None:
        """Do nothing: a domain ends with its participants."""


@dataclass
class Daemon:
    """One daemon, started by `midspan run`."""

    name: str
    file: Path
    port: int
    sides: list[str]
    process: Process | None = None
    watch: Hub | None = field(default=None, repr=False)

    def start(self) -> None:
        """Start the daemon without waiting for its workers."""
        self.process = Process([*MIDSPAN, "run", "--config", self.file], imports=DAEMON_AND_WORKERS)

    def status(self, side: str) -> dict[str, Any]:
        """Return the status of one of the daemon's workers."""
        if self.watch is None:
            settings = HubSettings(router=f"tcp/127.0.0.1:{self.port}", node="watch", shared_memory=False)
            self.watch = Hub.open(settings)
        answers = self.watch.ask("status", {}, daemon=self.name, timeout=ANSWER_SECONDS)
        return next((a.value for a in answers if isinstance(a.value, dict) and a.worker == side), {})

    def explain(self, side: str, topic: str) -> list[dict[str, Any]]:
        """Return the decisions of one of the daemon's workers on a topic."""
        assert self.watch is not None
        answers = self.watch.ask("explain", {"topic": topic}, daemon=self.name, timeout=ANSWER_SECONDS)
        return next((a.value for a in answers if isinstance(a.value, list) and a.worker == side), [])

    def processes(self, side: str = "") -> list[psutil.Process]:
        """Return the daemon's processes, or those of one worker."""
        assert self.process is not None
        whole = [psutil.Process(self.process.pid), *psutil.Process(self.process.pid).children(recursive=True)]
        return [p for p in whole if not side or p.pid == self.status(side).get("pid")]

    def kill(self) -> float:
        """Kill all the daemon's processes, the daemon itself first; return the time."""
        processes = self.processes()
        at = time.monotonic()
        for process in processes:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        assert self.process is not None
        self.process.popen.wait()
        self.process = None
        return at

    def signal(self, number: int) -> float:
        """Send a signal to all the daemon's processes, the daemon itself first; return the time."""
        at = time.monotonic()
        for process in self.processes():
            with contextlib.suppress(ProcessLookupError):  # it may exit meanwhile
                os.kill(process.pid, number)
        return at

    def end(self) -> None:
        """Request the daemon's stop; `close` waits for it."""
        if self.process is not None and self.process.popen.poll() is None:
            self.signal(signal.SIGCONT)
            self.process.signal(signal.SIGTERM)

    def close(self) -> None:
        """Stop the daemon, and wait until it has exited."""
        if self.watch is not None:
            self.watch.close()
        if self.process is not None:
            self.process.stop(DAEMON_SECONDS)


class Several:
    """The daemons and networks of one test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.daemons: list[Daemon] = []
        self._open: list[Any] = []
        self._folders: list[str] = []
        self._names = 0

    def ros1(self) -> Network:
        """Start a new ROS 1 network."""
        return self._opened(Ros1Network())

    def ros2(self) -> Network:
        """Return a new ROS 2 network."""
        return self._opened(Ros2Network())

    def _opened(self, network: Network) -> Network:
        self._open.append(network)
        return network

    def daemon(self, name: str, *networks: Network, join: Daemon | None = None, node: str = "midspan") -> Daemon:
        """Return a daemon on these networks with its own hub, whose router joins the router of ``join``."""
        folder = self.folder / name
        folder.mkdir()
        port = free_port()
        links = {"connect": {"endpoints": [f"tcp/127.0.0.1:{join.port}"]}} if join else {}
        config: dict[str, Any] = {
            "name": name,
            "state": self._short_folder(),
            "hub": {"listen": f"tcp/127.0.0.1:{port}", "router_zenoh": links, "lane": LANE},
            **{side: {"enabled": False} for side in ("ros1", "ros2")},
            **{n.side: {**n.settings(), "node": node} for n in networks},
        }
        config["ros1"].update({"poll": 0.1} if "master" in config["ros1"] else {})
        file = folder / "midspan.yaml"
        file.write_text(yaml.safe_dump(config))
        daemon = Daemon(name, file, port, [n.side for n in networks])
        self.daemons.append(daemon)
        return daemon

    def _short_folder(self) -> str:
        """Return a folder whose path is short enough for Unix sockets, because pytest's may be too long."""
        folder = tempfile.mkdtemp(prefix="midspan-")
        self._folders.append(folder)
        return folder

    def start(self, *daemons: Daemon) -> None:
        """Start daemons at the same time, and wait until each worker is active or on standby."""
        for daemon in daemons:
            daemon.start()
        try:
            for daemon, side in [(d, s) for d in daemons for s in d.sides]:
                until(lambda d=daemon, s=side: self._settled(d, s), f"{daemon.name} {side} settles", 60, every=0.2)
        except AssertionError:
            for daemon in daemons:
                assert daemon.process is not None
                print(
                    f"--- {daemon.name}", *map(daemon.status, daemon.sides), daemon.process.output()[-6000:], sep="\n"
                )
            raise

    @staticmethod
    def _settled(daemon: Daemon, side: str) -> bool:
        assert daemon.process is not None
        assert daemon.process.popen.poll() is None, daemon.process.output()[-5000:]
        return daemon.status(side).get("state") in ("running", "standby")

    def program(self, network: Network) -> Peer:
        """Start a native program."""
        self._names += 1
        peer = network.program(f"program_{self._names}")
        self._open.append(peer)
        return peer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        for thing in self._open:
            if isinstance(thing, Peer):
                thing.end()
        for daemon in self.daemons:
            daemon.end()
        for daemon in self.daemons:
            daemon.close()
        for thing in reversed(self._open):
            getattr(thing, "stop", getattr(thing, "close", None))()
        for state in self._folders:
            shutil.rmtree(state, ignore_errors=True)


class Flow:
    """A stream of numbers from one program to others, which count the received numbers."""

    def __init__(self, source: Peer, topic: str, *sinks: Peer, first: int = 0) -> None:
        self.source, self.sinks, self._first = source, sinks, first
        self._heard = [sink.subscribe(topic, STRING, depth=1000) for sink in sinks]
        self._out = source.advertise(topic, STRING, depth=1000, queue=1000)

    def until_through(self) -> None:
        """Publish periodically until each sink has received something."""

        def through() -> bool:
            self.source.publish(self._out, {"data": str(self._first)})
            self._first += 1
            return all(tally["received"] for tally in self.tallies())

        until(through, "every sink receives from the source", 30, every=0.1)

    def start(self, count: int, rate: float) -> None:
        """Publish ``count`` numbers on a thread."""
        self.source.ask("count", id=self._out, first=self._first, count=count, rate=rate)
        self._first += count

    def end(self, *, now: bool = False) -> int:
        """Wait until all numbers are published, and return how many."""
        return int(self.source.ask("counted", id=self._out, now=now)["sent"])

    def tallies(self, since: float = 0.0) -> list[dict[str, Any]]:
        """Return what each sink has received, as the ``tally`` command reports it."""
        return [s.ask("tally", id=i, since=since) for s, i in zip(self.sinks, self._heard, strict=True)]

    def duplicates(self) -> int:
        """Return how many received messages were duplicates, over all sinks."""
        return sum(t["received"] - t["distinct"] for t in self.tallies())

    def silence(self, since: float, seconds: float) -> float:
        """Return the longest time without a message at any sink, during the given seconds from ``since`` on."""
        until(lambda: all(t["last"] > since + seconds for t in self.tallies()), "messages continue", 30, every=0.1)
        return max(float(t["silence"]) for t in self.tallies(since))


def ring(several: Several, *, joined: bool, node: str = "midspan") -> tuple[list[Daemon], list[Network]]:
    """Start two daemons at the same time, which join the same ROS 1 and ROS 2 networks."""
    networks = [several.ros1(), several.ros2()]
    first = several.daemon("first", *networks)
    second = several.daemon("second", *networks, join=first if joined else None, node=node)
    several.start(first, second)
    return [first, second], networks


def triangle(several: Several, *, joined: bool, node: str = "midspan") -> tuple[list[Daemon], list[Network]]:
    """Join each pair of three networks, by separate hubs, or, if ``joined``, by hubs that are joined, too."""
    left, middle, right = several.ros1(), several.ros2(), several.ros1()
    first = several.daemon("one_two", left, middle)
    second = several.daemon("two_three", middle, right, join=first if joined else None, node=node)
    # A daemon joins only one ROS 1 network, so the third link needs two daemons with joined hubs, as on two machines.
    third = several.daemon("one", left, join=first if joined else None)
    fourth = several.daemon("three", right, join=third, node=node)
    daemons = [first, second, third, fourth]
    several.start(*daemons)
    return daemons, [left, middle, right]


def flows(several: Several, networks: list[Network]) -> list[Flow]:
    """Return a flow from each network to all others, once messages cross on each."""
    programs = [several.program(n) for n in networks]
    created = [
        Flow(source, f"/from_{number}", *(p for p in programs if p is not source))
        for number, source in enumerate(programs)
    ]
    for flow in created:
        flow.until_through()
    return created


def pour(made: list[Flow], count: int, rate: float) -> None:
    """Publish ``count`` numbers on all flows at once, and wait until nothing more arrives."""
    for flow in made:
        flow.start(count, rate)
    for flow in made:
        flow.end()
    quiet(made)


def quiet(made: list[Flow]) -> None:
    """Wait until nothing more arrives."""
    before: list[Any] = []

    def still() -> bool:
        nonlocal before
        now = [f.tallies() for f in made]
        same, before = now == before, now
        return same

    until(still, "nothing more arrives", 60, every=0.7)

"""One round's processes: roscore, the daemon, an end of each middleware on each side, and the background."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import benchmarks
from benchmarks.latency.cases import BACKGROUND, Case, Prepared, prepare
from bridge.demo import requirements
from bridge.demo.child import Child, guarded
from bridge.demo.place import Place
from bridge.demo.traces import marked, remove_unused, shared_memory, sweep

FLOOR, THERE, BACK = "floor", "there", "back"
"""First part of the topics' names: not bridged, from ROS 1 to ROS 2, from ROS 2 to ROS 1."""

UP_SECONDS = 40.0
_WARM = 3
_MEMORY = {"MALLOC_MMAP_THRESHOLD_": "1000000000", "MALLOC_TRIM_THRESHOLD_": "1000000000"}
"""glibc keeps freed memory in the ends: with its defaults each large message is paid for again by page faults, 1 MB
over ROS 1 twice and 6 MB over ROS 2 four times as dear, and the floor would be that much easier to reach."""

_PROFILE = Path(__file__).with_name("fastdds.xml")


class Network:
    """All processes of one round, new ones.

    Args:
        cases: the messages that will be sent.
        idle: bridged topics on which nothing is sent, half of them from each side.
        busy: bridged topics on which 20 messages a second are sent, half of them from each side.
        shared_memory: the hub's setting, for the daemon and the zenoh ends alike.
    """

    def __init__(self, cases: Sequence[Case], *, idle: int, busy: int, shared_memory: bool) -> None:
        self._children: dict[str, Child] = {}
        self._place = Place(None, {
            "hub": {"shared_memory": shared_memory},
            "ros2": {"transport": "shared_memory"},  # as the ends; "auto" looks who else is on the machine
            "routing": {"rules": [{"topic": f"/{FLOOR}/**", "deny": True}]},
            "log": {"level": "warning"},
        })  # fmt: skip
        try:
            self._shared_memory = shared_memory
            self.messages = {case.key: prepare(case, self._place.folder) for case in cases}
            self._background = prepare(BACKGROUND, self._place.folder)
            (self._place.system_path / "benchmarks").symlink_to(Path(benchmarks.__path__[0]))
            self._start(idle, busy)
        except BaseException:
            self.close()
            raise

    def measure(self, prepared: Prepared, hop: str, count: int) -> list[int]:
        """One-way latencies in nanoseconds of so many messages.

        Args:
            prepared: the message.
            hop: ``ros1``, ``ros2`` or ``zenoh`` for the floor's hops, ``there`` or ``back`` for the whole way.
            count: messages after the first ones, which do not count.
        """
        topic = f"/{hop if hop in (THERE, BACK) else FLOOR}/{prepared.case.key}"
        source, target = {THERE: ("ros1", "ros2"), BACK: ("ros2", "ros1")}.get(hop, (hop, hop))
        sender, listener = self._children[f"{source} sender"], self._children[f"{target} listener"]
        period = 1 / prepared.case.rate
        self._command(listener, "clear", "cleared")
        self._command(sender, "send", "sent", topic=topic, count=_WARM + count, period=period)
        told = self._command(listener, "collect", "collected", topic=topic, count=_WARM + count, seconds=2.0)
        ages: list[int] = told["ages"]
        return ages[_WARM:]

    def prefer(self) -> None:
        """Have all these processes scheduled before the machine's others (Linux, root); for all alike, so fair."""
        for pid in marked(self._place.folder):
            for task in Path(f"/proc/{pid}/task").iterdir():
                with contextlib.suppress(ProcessLookupError):
                    os.sched_setscheduler(int(task.name), os.SCHED_RR, os.sched_param(1))

    def background_rate(self) -> float:
        """Messages of the busy background that arrive in a second."""
        self._background_heard()
        began = time.monotonic()
        time.sleep(1.0)
        return self._background_heard() / (time.monotonic() - began)

    def _background_heard(self) -> int:
        total = 0
        for sink, topics in self._sunk.items():
            child = self._children[sink]
            for topic in topics:
                told = self._command(child, "collect", "collected", topic=topic, count=0, seconds=0.0)
                total += len(told["ages"])
            self._command(child, "clear", "cleared")
        return total

    # -- start ---------------------------------------------------------------------------------------------------------

    def _start(self, idle: int, busy: int) -> None:
        place = self._place
        self._sunk: dict[str, list[str]] = {}
        packages = requirements.ros1_packages(place.config)
        self._ros1 = place.ros1_environment(packages) | _MEMORY
        self._own = (
            place.environment()
            | _MEMORY
            | {
                "FASTRTPS_DEFAULT_PROFILES_FILE": str(_PROFILE),
                "FASTDDS_DEFAULT_PROFILES_FILE": str(_PROFILE),
                "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
            }
        )
        roscore = guarded(requirements.SYSTEM_PYTHON, requirements.roscore(place.config), "-p", str(place.master_port))
        self._children["roscore"] = Child("roscore", roscore, self._ros1, place.folder)
        daemon = guarded(sys.executable, "-m", "bridge.cli.main", "run", "--config", place.config_file)
        self._children["daemon"] = Child("daemon", daemon, place.environment(), place.folder)
        end = time.monotonic() + UP_SECONDS
        while not place.master_answers() and time.monotonic() < end:
            time.sleep(0.1)
        kinds = ("ros1", "ros2", "zenoh")
        for kind in kinds:
            self._launch(f"{kind} listener")
            self._launch(f"{kind} sender")
        if idle:
            self._launch("ros1 idler")
            self._launch("ros2 idler")
        if busy:
            for name in ("ros1 drummer", "ros2 drummer", "ros1 sink", "ros2 sink"):
                self._launch(name)
        for name, child in self._children.items():
            if name not in ("roscore", "daemon"):
                self._await(child, "ready")
        self._open(kinds)
        self._open_background(idle, busy)
        self._wait_until_up(kinds)

    def _launch(self, name: str) -> None:
        kind, place = name.split()[0], self._place
        command: list[str | Path]
        if kind == "ros1":
            command, env = [requirements.SYSTEM_PYTHON, "-m", "benchmarks.latency.ros1_end"], self._ros1
        elif kind == "ros2":
            command, env = [sys.executable, "-m", "benchmarks.latency.ros2_end"], self._own
        else:
            memory = "1" if self._shared_memory else "0"
            router = f"tcp/127.0.0.1:{place.router_port}"
            command, env = [sys.executable, "-m", "benchmarks.latency.zenoh_end", router, memory], self._own
        self._children[name] = Child(name, command, env, place.folder)

    def _open(self, kinds: Sequence[str]) -> None:
        ways = {"ros1": (THERE, BACK), "ros2": (BACK, THERE), "zenoh": (None, None)}
        for kind in kinds:
            for role, event, way in (("listener", "subscribe", ways[kind][1]), ("sender", "advertise", ways[kind][0])):
                parts = [FLOOR] if way is None else [FLOOR, way]
                topics = [
                    m.topic(f"/{p}/{m.case.key}", ros1=kind == "ros1") for p in parts for m in self.messages.values()
                ]
                self._command(self._children[f"{kind} {role}"], event, f"{event}d", topics=topics)

    def _open_background(self, idle: int, busy: int) -> None:
        for kind, other in (("ros1", "ros2"), ("ros2", "ros1")):
            if idle:
                topics = [f"/idle/{kind}_{i}" for i in range(idle // 2)]
                self._command(self._children[f"{kind} idler"], "idle", "idle", topics=topics, type_=BACKGROUND.type)
            if busy:
                names = self._sunk[f"{other} sink"] = [f"/busy/{kind}_{i}" for i in range(busy // 2)]
                sink, drummer = self._children[f"{other} sink"], self._children[f"{kind} drummer"]
                heard = [self._background.topic(name, ros1=other == "ros1") for name in names]
                sent = [self._background.topic(name, ros1=kind == "ros1") for name in names]
                self._command(sink, "subscribe", "subscribed", topics=heard)
                self._command(drummer, "advertise", "advertised", topics=sent)
                self._command(drummer, "drum", "drumming", topics=names, rate=20.0)

    def _wait_until_up(self, kinds: Sequence[str]) -> None:
        """Until every topic of the benchmark has a message through, the whole way."""
        for key in self.messages:
            for hop in (*kinds, THERE, BACK):
                source, target = {THERE: ("ros1", "ros2"), BACK: ("ros2", "ros1")}.get(hop, (hop, hop))
                topic = f"/{hop if hop in (THERE, BACK) else FLOOR}/{key}"
                self._command(self._children[f"{source} sender"], "matched", "matched", topic=topic)
                end = time.monotonic() + UP_SECONDS
                while not self._reaches(source, target, topic):
                    if time.monotonic() > end:
                        msg = f"nothing comes through on {topic} from {source} to {target}:\n{self._words()}"
                        raise RuntimeError(msg)
        time.sleep(1.0)

    def _reaches(self, source: str, target: str, topic: str) -> bool:
        self._command(self._children[f"{source} sender"], "send", "sent", topic=topic, count=1, period=0.0)
        listener = self._children[f"{target} listener"]
        return bool(self._command(listener, "collect", "collected", topic=topic, count=1, seconds=0.5)["ages"])

    def _command(self, child: Child, do: str, event: str, **params: Any) -> dict[str, Any]:
        child.ask(do, **params)
        return self._await(child, event)

    def _await(self, child: Child, event: str) -> dict[str, Any]:
        told = child.wait_for(event, UP_SECONDS)
        if told is None:
            msg = f"{child.name} did not answer ({event}):\n{child.last_words()}"
            raise RuntimeError(msg)
        return told

    def _words(self) -> str:
        return self._children["daemon"].last_words()

    # -- the end -------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """End all processes."""
        memory = shared_memory(self._place.folder, self._place.domain_ports)
        last = ("daemon", "roscore")
        groups = [[name for name in self._children if name not in last], *([name] for name in last)]
        for group in groups:
            children = [self._children[name] for name in group if name in self._children]
            for child in children:
                child.begin_stop()
            for child in children:
                child.finish_stop(9.0)
        sweep(self._place.folder)
        remove_unused(memory)
        self._place.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

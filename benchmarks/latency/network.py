"""The processes of one round: roscore, the daemon, and senders and listeners on ROS 1, ROS 2 and zenoh."""

from __future__ import annotations

import time
from collections.abc import Sequence

from benchmarks.latency.cases import BACKGROUND, Case, Prepared, prepare
from benchmarks.latency.stage import Stage

FLOOR, THERE, BACK = "floor", "there", "back"
"""Prefixes of topic names: not bridged, from ROS 1 to ROS 2, from ROS 2 to ROS 1."""

_WARM = 3  # number of messages at the beginning of a measurement that do not count


class Network(Stage):
    """The processes of one round, all newly started.

    Args:
        cases: the messages to send.
        idle: number of bridged topics without messages, half of them from each side.
        busy: number of bridged topics with 20 messages per second, half of them from each side.
        shared_memory: the hub's setting, for the daemon and the zenoh ends.
        lane: the hub's setting.
        apart: topics that are not bridged, in addition to the floor's.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        *,
        idle: int,
        busy: int,
        shared_memory: bool,
        lane: bool = True,
        apart: Sequence[str] = (),
    ) -> None:
        super().__init__({
            "hub": {"shared_memory": shared_memory, "lane": lane},
            "ros2": {"transport": "shared_memory"},  # as in the ends; "auto" depends on other programs on the machine
            "routing": {"rules": [{"topic": topic, "deny": True} for topic in (f"/{FLOOR}/**", *apart)]},
            "log": {"level": "warning"},
        })  # fmt: skip
        try:
            self._shared_memory = shared_memory
            self.messages = {case.key: prepare(case, self.place.folder) for case in cases}
            self._background = prepare(BACKGROUND, self.place.folder)
            self._start(idle, busy)
        except BaseException:
            self.close()
            raise

    def measure(self, prepared: Prepared, hop: str, count: int) -> list[int]:
        """Return the one-way latencies of messages, in nanoseconds.

        Args:
            prepared: the message.
            hop: ``ros1``, ``ros2`` or ``zenoh`` for the floor's hops, ``there`` or ``back`` for the whole path.
            count: number of messages, without the first ones.
        """
        topic = f"/{hop if hop in (THERE, BACK) else FLOOR}/{prepared.case.key}"
        source, target = {THERE: ("ros1", "ros2"), BACK: ("ros2", "ros1")}.get(hop, (hop, hop))
        sender, listener = f"{source} sender", f"{target} listener"
        period = 1 / prepared.case.rate
        self.command(listener, "clear", "cleared")
        self.command(sender, "send", "sent", topic=topic, count=_WARM + count, period=period)
        reply = self.command(listener, "collect", "collected", topic=topic, count=_WARM + count, seconds=2.0)
        ages: list[int] = reply["ages"]
        return ages[_WARM:]

    def background_rate(self) -> float:
        """Return the received messages of the busy background per second."""
        self._background_received()
        began = time.monotonic()
        time.sleep(1.0)
        return self._background_received() / (time.monotonic() - began)

    def _background_received(self) -> int:
        total = 0
        for sink, topics in self._sunk.items():
            for topic in topics:
                reply = self.command(sink, "collect", "collected", topic=topic, count=0, seconds=0.0)
                total += len(reply["ages"])
            self.command(sink, "clear", "cleared")
        return total

    # -- start ---------------------------------------------------------------------------------------------------------

    def _start(self, idle: int, busy: int) -> None:
        self._sunk: dict[str, list[str]] = {}
        self.start_bridge()
        kinds = ("ros1", "ros2", "zenoh")
        for kind in kinds:
            self._launch_end(f"{kind} listener")
            self._launch_end(f"{kind} sender")
        if idle:
            self._launch_end("ros1 idler")
            self._launch_end("ros2 idler")
        if busy:
            for name in ("ros1 drummer", "ros2 drummer", "ros1 sink", "ros2 sink"):
                self._launch_end(name)
        for name in self._children:
            if name not in ("roscore", "daemon"):
                self.wait_for(name, "ready")
        self._open(kinds)
        self._open_background(idle, busy)
        self._wait_until_up(kinds)

    def _launch_end(self, name: str) -> None:
        kind = name.split()[0]
        arguments = []
        if kind == "zenoh":
            arguments = [f"tcp/127.0.0.1:{self.place.router_port}", "1" if self._shared_memory else "0"]
        self.launch(name, f"benchmarks.latency.{kind}_end", *arguments, system=kind == "ros1")

    def _open(self, kinds: Sequence[str]) -> None:
        prefixes = {"ros1": (THERE, BACK), "ros2": (BACK, THERE), "zenoh": (None, None)}
        for kind in kinds:
            for role, event, prefix in (
                ("listener", "subscribe", prefixes[kind][1]),
                ("sender", "advertise", prefixes[kind][0]),
            ):
                parts = [FLOOR] if prefix is None else [FLOOR, prefix]
                topics = [
                    m.topic(f"/{p}/{m.case.key}", ros1=kind == "ros1") for p in parts for m in self.messages.values()
                ]
                self.command(f"{kind} {role}", event, f"{event}d", topics=topics)

    def _open_background(self, idle: int, busy: int) -> None:
        for kind, other in (("ros1", "ros2"), ("ros2", "ros1")):
            if idle:
                topics = [f"/idle/{kind}_{i}" for i in range(idle // 2)]
                self.command(f"{kind} idler", "idle", "idle", topics=topics, type_=BACKGROUND.type)
            if busy:
                names = self._sunk[f"{other} sink"] = [f"/busy/{kind}_{i}" for i in range(busy // 2)]
                sink, drummer = f"{other} sink", f"{kind} drummer"
                subscribed = [self._background.topic(name, ros1=other == "ros1") for name in names]
                sent = [self._background.topic(name, ros1=kind == "ros1") for name in names]
                self.command(sink, "subscribe", "subscribed", topics=subscribed)
                self.command(drummer, "advertise", "advertised", topics=sent)
                self.command(drummer, "drum", "drumming", topics=names, rate=20.0)

    def _wait_until_up(self, kinds: Sequence[str]) -> None:
        """Wait until a message has arrived on every measured topic."""
        for key in self.messages:
            for hop in (*kinds, THERE, BACK):
                source, target = {THERE: ("ros1", "ros2"), BACK: ("ros2", "ros1")}.get(hop, (hop, hop))
                topic = f"/{hop if hop in (THERE, BACK) else FLOOR}/{key}"
                self.command(f"{source} sender", "matched", "matched", topic=topic)
                self.until_crosses(f"{source} sender", f"{target} listener", topic)
        time.sleep(1.0)

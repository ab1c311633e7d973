"""Receives the frames for a command, in a buffer that is filled from the two topics of transforms."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Self

from typing_extensions import override

from bridge.client.authorities import Authorities
from bridge.client.errors import ClientError
from bridge.client.feed import TopicFeed
from bridge.client.graph import absolute
from bridge.client.session import Client
from bridge.clock import RunClock
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.node import follow_clock
from bridge.text import clean, side_name
from bridge.tf.buffer import TransformBuffer
from bridge.tf.stamped import TF, TF_STATIC, TF_TYPE, read

_WINDOW = 1000
_RATE_SECONDS = 5.0


class FrameMeter:
    """Counts one frame's transforms, and measures the newest thousand; ``arrived``: time of the last (monotonic)."""

    def __init__(self) -> None:
        self.count = 0
        self.arrived = 0.0
        self._arrivals: deque[float] = deque(maxlen=_WINDOW)
        self._delays: deque[int] = deque(maxlen=_WINDOW)

    def add(self, arrived: float, delay: int | None) -> None:
        """Count a transform; ``delay`` is its age on arrival in nanoseconds, None for a static one."""
        self.count += 1
        self.arrived = arrived
        self._arrivals.append(arrived)
        if delay is not None:
            self._delays.append(delay)

    def rate(self, now: float) -> float:
        """Return the transforms per second over the last five seconds; 0 if fewer than two arrived."""
        recent = [at for at in self._arrivals if at >= now - _RATE_SECONDS]
        whole = recent[-1] - recent[0] if recent else 0.0
        return (len(recent) - 1) / whole if whole > 0 else 0.0

    @property
    def delay(self) -> float | None:
        """The mean time from stamp to arrival in seconds, None for static transforms."""
        return sum(self._delays) / len(self._delays) / 1e9 if self._delays else None

    @property
    def longest(self) -> float | None:
        """The longest time from stamp to arrival in seconds, None for static transforms."""
        return max(self._delays) / 1e9 if self._delays else None

    def copy(self) -> Self:
        """Return a copy with the current values."""
        copy = type(self)()
        copy.count, copy.arrived = self.count, self.arrived
        copy._arrivals, copy._delays = self._arrivals.copy(), self._delays.copy()
        return copy


QUIET, MOST = 0.15, 1.0
"""Seconds without a new frame after which all frames count as known, if each publisher has sent some; longest wait."""

PATIENCE = 5.0
"""Seconds to wait for the first transform."""

_REFRESH_SECONDS = 0.5
_FIRST_SECONDS = 0.02


class TransformFeed(TopicFeed):
    """Receives one topic's transforms for a `TransformListener`."""

    def __init__(self, listener: TransformListener, topic: str, *, static: bool, side: str | None) -> None:
        super().__init__(listener.client, topic, side)
        self._listener, self._static = listener, static

    @override
    def on_sample(self, sample: HubSample, type_name: str, type_hash: str, side: str) -> None:
        if type_name == TF_TYPE:
            self._listener.receive(sample, side, static=self._static)


class TransformListener:
    """Receives frames of `namespace` + `/tf` and `/tf_static`, by default of all sides. Safe to use from any thread."""

    def __init__(self, client: Client, namespace: str = "", side: str | None = None) -> None:
        self.client = client
        self.buffer = TransformBuffer()
        self.clock = RunClock(simulated=client.config.clock.simulated)
        self._meters: dict[str, FrameMeter] = {}
        self._authorities = Authorities(client.hub.graph, side_name)
        self._known: set[tuple[str, str, bytes]] = set()  # frame, parent and publisher
        self._new_at = 0.0  # when a new frame, parent or publisher last appeared (monotonic)
        self._lock = threading.Lock()
        self._bad = ""
        namespace = absolute(namespace).rstrip("/") if namespace else ""
        self._feeds = [
            TransformFeed(self, namespace + TF, static=False, side=side),
            TransformFeed(self, namespace + TF_STATIC, static=True, side=side),
        ]

    def open(self) -> None:
        """Subscribe."""
        follow_clock(self.clock, self.client.hub)
        self.clock.on_jump(self.buffer.clear)
        self.client.catch_up()  # `refresh` finds later publishers while it listens
        self.refresh()

    def listen(self, seconds: float) -> None:
        """Receive for ``seconds``, including from new publishers."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(left, _REFRESH_SECONDS))
            self.refresh()

    def gather(self) -> float:
        """Receive until all frames are probably known, for at most `MOST` seconds; return the seconds that it took."""
        began = time.monotonic()
        while (passed := time.monotonic() - began) < MOST:
            if time.monotonic() - max(began, self._new_at) >= QUIET and self._all_spoke():
                break
            time.sleep(_FIRST_SECONDS)
            self.refresh()
        return passed

    def _all_spoke(self) -> bool:
        """Whether each publisher has sent a transform; False if one is a bridge: its side may have many publishers."""
        with self._lock:
            received = {gid for _, _, gid in self._known}
        topics = {feed.topic for feed in self._feeds}
        others = [e for e in self.client.hub.graph.publishers() if e.topic in topics and not e.own]
        return all(e.origin is None and not e.pending and e.gid in received for e in others)

    def refresh(self) -> None:
        """Subscribe to new publishers."""
        for feed in self._feeds:
            feed.refresh()

    def receive(self, sample: HubSample, side: str, *, static: bool) -> None:
        """Add a message's transforms to the buffer and to the frames' meters."""
        cdr, now = sample.data(), self.clock.now_ns()
        authority = self._authorities.name(sample.gid, side_name(side))
        try:
            self.buffer.set_message(cdr, authority, static=static)
        except ValueError as err:
            self._bad = f"{authority}: {err}"
            return
        arrived = time.monotonic()
        with self._lock:
            for transform in read(cdr):
                name = transform.child_frame_id.lstrip("/")
                known = name, transform.frame_id, sample.gid
                if known not in self._known:
                    self._known.add(known)
                    self._new_at = arrived
                meter = self._meters.get(name)
                if meter is None:
                    meter = self._meters[name] = FrameMeter()
                meter.add(arrived, None if static else now - transform.stamp)

    def meters(self) -> dict[str, FrameMeter]:
        """Return the statistics of each frame by its name."""
        with self._lock:
            return {name: meter.copy() for name, meter in self._meters.items()}

    def wait(self) -> None:
        """Wait for the first transform; raises `ClientError` if none arrives."""
        end = time.monotonic() + PATIENCE
        while not self.buffer.changes:
            if time.monotonic() > end:
                raise ClientError(self._nothing())
            self.listen(_FIRST_SECONDS)

    def close(self) -> None:
        self.clock.close()
        for feed in self._feeds:
            feed.close()

    def troubles(self) -> list[str]:
        """Return lines on refused, malformed and lost transforms."""
        lines = []
        if refused := self.buffer.refused:  # the first of each kind was logged with its values
            lines.append("refused: " + ", ".join(f"{reason} {count}" for reason, count in refused.items()))
        if self._bad:
            lines.append(clean(self._bad))
        if lost := sum(feed.lost for feed in self._feeds):
            lines.append(f"{lost} messages were lost on the hub")
        return lines

    def _nothing(self) -> str:
        topics = [feed.topic for feed in self._feeds]
        publishers = self.client.hub.graph.publishers()
        others = {e.topic for e in publishers if e.type_name == TF_TYPE and not e.own}.difference(topics)
        hint = f"; transforms are on {clean(', '.join(sorted(others)))}: see --namespace" if others else ""
        return f"no transform arrived on {' or '.join(topics)} for {PATIENCE:g} s{hint}"

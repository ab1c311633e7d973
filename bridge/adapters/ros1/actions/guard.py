"""Keeps goals out that name frames which the side does not have; see docs/actions.md for the rule."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque

from bridge.adapters.ros1.actions.frames import TF_TYPES, Frames, frames_in, names_frames, without_slashes
from bridge.adapters.ros1.actions.network import Ear, Network
from bridge.adapters.ros1.graph import Look
from bridge.messages.conversion import SideType
from bridge.messages.definition import Schema

_log = logging.getLogger(__name__)

KNOW_SECONDS = 2.0
"""How long transforms are heard before a frame that none of them names is held not to be there."""

SILENT_SECONDS = 10.0
"""How long the first one is waited for where there are topics for them; then every frame is let through."""

_WARN_SECONDS = 60.0
_MAX_TOPICS = 100

_TF = SideType("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec", "")
"""tf/tfMessage has the same md5."""


class FrameGuard:
    """Hears the side's transforms while actions are open, and judges the frames of goals."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._lock = threading.Lock()
        self._users: set[object] = set()
        self._topics: frozenset[str] = frozenset()
        self._ears: dict[str, Ear] = {}
        self._frames = Frames()
        self._opened = self._heard = float("inf")
        self._reports: deque[tuple[float, str]] = deque(maxlen=10)

    def open(self, user: object) -> None:
        """Somebody's goals are to be judged."""
        with self._lock:
            if not self._users:
                self._opened, self._heard, self._frames = time.monotonic(), float("inf"), Frames()
            self._users.add(user)
        self._follow()

    def close(self, user: object) -> None:
        """Somebody sends no goals any more."""
        with self._lock:
            self._users.discard(user)
        self._follow()

    def seen(self, look: Look | None) -> None:
        """One look at the master: topics with transforms are known by their type, whatever their names."""
        topics = sorted(t for t, kind in look.types.items() if kind in TF_TYPES) if look is not None else []
        self._topics = frozenset(topics[:_MAX_TOPICS])
        self._follow()

    def _follow(self) -> None:
        with self._lock:
            wanted = self._topics if self._users and self._network.check_frames else frozenset()
            gone = [self._ears.pop(topic) for topic in self._ears.keys() - wanted]
            for topic in wanted - self._ears.keys():
                self._ears[topic] = self._network.hear(topic, _TF, self._on_transforms, "_frames")
        for ear in gone:
            ear.close()

    def _on_transforms(self, payload: bytes, _source: str, _time: int | None) -> None:
        self._frames.learn(payload)
        if self._frames:
            self._heard = min(self._heard, time.monotonic())

    def check(self, schema: Schema, body: bytes) -> tuple[bytes, str | None]:
        """Judge a goal.

        Returns:
            The goal with no slash before its frames, and why it must not be sent; "" where it may, None where that is
            not known yet: hardly any transforms have come.

        Raises:
            ConversionError: it is no such goal.
        """
        if not self._network.check_frames or not names_frames(schema):
            return body, ""
        body = without_slashes(body, frames_in(schema, body))
        trouble = self._frames.trouble(frames_in(schema, body)) if self._topics else ""
        if trouble and time.monotonic() < min(self._heard + KNOW_SECONDS, self._opened + SILENT_SECONDS):
            return body, None
        return body, trouble if self._frames else ""

    def report(self, action: str, trouble: str) -> None:
        """Tell people why a goal was rejected: ROS 2's answer has no words."""
        _log.warning("%s: a goal is rejected: %s", action, trouble)
        self._reports.append((time.monotonic(), f"{action}: a goal was rejected: {trouble}"))

    def warnings(self) -> list[str]:
        """What was reported lately."""
        return [text for at, text in list(self._reports) if at > time.monotonic() - _WARN_SECONDS]

"""Whether the base stands still, according to odometry, or to its velocity commands if there is no odometry."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import NamedTuple

from bridge.client.velocity import driven_forms
from bridge.hub.wire.qos import Qos
from bridge.messages.velocities import TWIST, TWIST_STAMPED
from bridge.modules.endpoints import Subscription
from bridge.modules.host import Host
from navigation.frames import FramesError, RobotFrames
from navigation.pose import Pose

STANDING_SECONDS = 0.4
"""A base whose odometry has not changed for this time stands still."""

STILL_METERS, STILL_RADIANS = 0.005, 0.01
"""The odometry of a standing base changes by less than this within `STANDING_SECONDS`."""

SILENCE_SECONDS = 1.0
"""A base without a velocity command for this time stands still: every base stops after 0.1 to 0.5 s without one."""

ZERO_SECONDS = 0.3
"""A base that receives only zero velocities for this time stands still."""

FRESH_SECONDS = 0.35
"""The last pose is used for no longer than this, because odometry may end just before the base begins to move."""

OLD_SECONDS = 0.6
"""A pose that was measured longer ago shows nothing, even if it has just arrived: odometry may wait in a queue.

`RobotFrames` returns poses of up to 0.5 s, and a poll later they are 0.1 s older.
"""

STALL_SECONDS = 0.5
"""After a longer pause between two checks, velocity commands may have arrived that have not been read yet."""

_HISTORY_SECONDS = 3.0
"""Poses are kept for this time, for `Motion.speed`."""


class Base(Enum):
    """Whether the base moves."""

    UNKNOWN = "unknown"
    STANDING = "standing"
    MOVING = "moving"


class _Seen(NamedTuple):
    """A pose of the base, with times in monotonic seconds."""

    arrival: float
    measured: float  #: according to the pose's stamp, but not after the arrival; in simulated time, the arrival
    pose: Pose


class Motion:
    """Follows the base's odometry: `poll` on the module's thread, everything else on any thread.

    Args:
        now_ns: returns the time of the stamps' clock.
        simulated: the stamps are those of a simulation, which may run faster than real time.
    """

    def __init__(self, frames: RobotFrames, now_ns: Callable[[], int], *, simulated: bool = False) -> None:
        self._frames, self._now_ns, self._simulated = frames, now_ns, simulated
        self._poses: tuple[_Seen, ...] = ()
        """Never changed, only replaced, because other threads read the tuple."""
        self._moved = False  # whether the base moved when its odometry last showed whether it moves

    def poll(self) -> None:
        """Record the pose of the base; called about ten times a second."""
        now = time.monotonic()
        try:
            pose = self._frames.odometry()
        except FramesError:
            self._poses = ()
            return
        before = self._poses
        if not before or pose.stamp_ns != before[-1].pose.stamp_ns:
            age = 0.0 if self._simulated else max(0.0, (self._now_ns() - pose.stamp_ns) / 1e9)
            recent = (seen for seen in before if seen.arrival >= now - _HISTORY_SECONDS)
            self._poses = (*recent, _Seen(now, now - age, pose))
        standing = self.is_standing()
        if standing is not None:
            self._moved = not standing

    def rest(self) -> None:
        """Count the base as no longer moving, because something other than odometry has shown that."""
        self._moved = False

    def is_standing(self, since: float = 0.0) -> bool | None:
        """Return whether the base has stood for `STANDING_SECONDS`, in three or more poses.

        None if odometry is missing, has ended, is old, or does not cover this time.

        The poses' stamps count and, except in simulated time, also their times of arrival. Poses that were measured
        before ``since`` (monotonic seconds) do not count.
        """
        poses = self._poses
        if not poses:
            return None
        newest, last = poses[-1], poses[-1].pose
        for count, (arrival, measured, pose) in enumerate(reversed(poses)):
            rotation = math.remainder(pose.theta - last.theta, math.tau)
            if math.hypot(pose.x - last.x, pose.y - last.y) > STILL_METERS or abs(rotation) > STILL_RADIANS:
                return False
            if measured < since:
                return None
            passed = (last.stamp_ns - pose.stamp_ns) / 1e9
            if not self._simulated:
                passed = min(passed, newest.arrival - arrival)  # a step of the odometry's clock is not time that passed
            if passed >= STANDING_SECONDS and count >= 2:
                return True if self._simulated or self._is_fresh(newest) else None
        return None

    @staticmethod
    def _is_fresh(seen: _Seen) -> bool:
        return time.monotonic() < min(seen.arrival + FRESH_SECONDS, seen.measured + OLD_SECONDS)

    def base(self, since: float = 0.0) -> Base:
        """Return the base's state from odometry since a time; `Base.UNKNOWN` until it has covered enough time.

        A base that moved when its odometry ended counts as moving until something shows that it stands.
        """
        unknown = Base.MOVING if self._moved else Base.UNKNOWN
        return {True: Base.STANDING, False: Base.MOVING, None: unknown}[self.is_standing(since)]

    @property
    def known(self) -> bool:
        """Whether there is odometry."""
        return bool(self._poses)

    @property
    def speed(self) -> float | None:
        """Meters per second over the last seconds; None if unknown, or if the base hardly moves."""
        poses = self._poses
        if len(poses) < 2:
            return None
        first, last = poses[0].pose, poses[-1].pose
        seconds = (last.stamp_ns - first.stamp_ns) / 1e9
        moved = math.hypot(last.x - first.x, last.y - first.y)
        return moved / seconds if seconds > 0 and moved > 2 * STILL_METERS else None


_TWIST = struct.Struct("<6d")
_STRING_LENGTH = struct.Struct("<I")
_HEADER = 4
"""Bytes of CDR's encapsulation header, before the six numbers of a ``geometry_msgs/Twist``."""

_FRAME_ID = _HEADER + 8
"""Offset of the frame's name in a ``geometry_msgs/TwistStamped``, after its stamp."""


class VelocityWatch:
    """Follows the velocity commands to the base, stamped or not, while it is open. For stops without odometry.

    Zeros have to arrive in each form that may drive the base, or in either form if all known nodes accept both.
    """

    def __init__(self, host: Host, topic: str) -> None:
        self._host, self._topic = host, topic
        self._subscriptions: list[Subscription] = []
        self._opened = self._checked_at = 0.0
        self._moving_at = -math.inf  # when the last command other than zero arrived (monotonic)
        self._zero_at: dict[str, float] = {}

    def open(self) -> None:
        """Subscribe, if not subscribed yet."""
        if self._subscriptions or not self._topic:
            return
        self._opened = self._checked_at = time.monotonic()
        self._moving_at, self._zero_at = -math.inf, {}
        for kind, begin in ((TWIST, _begin_of_twist), (TWIST_STAMPED, _begin_of_stamped)):
            receive = partial(self._on_velocity, kind, begin)
            self._subscriptions.append(
                self._host.node.subscription_cdr(self._topic, kind, receive, Qos(depth=1), at_once=True)
            )

    def close(self) -> None:
        while self._subscriptions:
            self._host.node.release(self._subscriptions.pop())

    def zero(self, since: float) -> bool:
        """Return whether the base is commanded to stand: zeros only, or silence for `SILENCE_SECONDS`.

        Commands before ``since`` (monotonic seconds) do not count, nor does silence while this process stalled, so that
        this has to be called often. Without a velocity topic the result is False.
        """
        if not self._subscriptions:
            return False
        now = time.monotonic()
        if now > self._checked_at + STALL_SECONDS:
            self._opened = now
        self._checked_at = now
        begin = max(self._moving_at, self._opened, since)
        return now > begin + (ZERO_SECONDS if self._last_zero() > begin else SILENCE_SECONDS)

    def _last_zero(self) -> float:
        """Return when the base received the last zero; if both forms may drive it, when it had received both."""
        forms, zeros = driven_forms(self._host.node.hub.graph, self._topic), self._zero_at
        if forms:
            return min(zeros.get(form, -math.inf) for form in forms)
        return max(zeros.values(), default=-math.inf)

    def _on_velocity(self, kind: str, begin: Callable[[bytes], int], cdr: bytes) -> None:
        """Record a velocity; runs on a thread of zenoh. ``begin`` returns the offset of the six numbers."""
        now, offset = time.monotonic(), begin(cdr)
        if len(cdr) < offset + _TWIST.size or any(_TWIST.unpack_from(cdr, offset)):
            self._moving_at = now
        else:
            self._zero_at[kind] = now


def _begin_of_twist(_cdr: bytes) -> int:
    return _HEADER


def _begin_of_stamped(cdr: bytes) -> int:
    """Return the offset of the velocity, aligned to 8 bytes after the frame's name; past the end if it is truncated."""
    if len(cdr) < _FRAME_ID + _STRING_LENGTH.size:
        return len(cdr)
    (length,) = _STRING_LENGTH.unpack_from(cdr, _FRAME_ID)
    body = _FRAME_ID + _STRING_LENGTH.size + length - _HEADER
    return int(_HEADER + (body + 7) // 8 * 8)

"""What odometry said lately."""

from __future__ import annotations

from collections import deque

from navigation.pose import Pose, wrapped

_KEPT_NS = 3_000_000_000
_MOST = 1000


class Track:
    """Poses in the odometry's frame, in the order of their stamps."""

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque(maxlen=_MOST)

    @property
    def newest(self) -> Pose | None:
        """What was said last."""
        return self._poses[-1] if self._poses else None

    def add(self, pose: Pose) -> None:
        """Take up another; one that is not newer than the last takes its place, with all that came after it."""
        while self._poses and self._poses[-1].stamp_ns >= pose.stamp_ns:
            self._poses.pop()
        self._poses.append(pose)
        while self._poses[0].stamp_ns < pose.stamp_ns - _KEPT_NS:
            self._poses.popleft()

    def at(self, stamp_ns: int) -> Pose | None:
        """Where the base was; before and behind all that is known, the nearest. None where nothing is known."""
        later = None
        for pose in reversed(self._poses):
            if pose.stamp_ns <= stamp_ns:
                return pose if later is None else _between(pose, later, stamp_ns)
            later = pose
        return later

    def clear(self) -> None:
        """Forget all: the clock or the odometry began anew."""
        self._poses.clear()


def _between(one: Pose, two: Pose, stamp_ns: int) -> Pose:
    share = (stamp_ns - one.stamp_ns) / (two.stamp_ns - one.stamp_ns)
    turned = wrapped(two.theta - one.theta)
    return Pose(
        one.x + share * (two.x - one.x),
        one.y + share * (two.y - one.y),
        wrapped(one.theta + share * turned),
        stamp_ns,
    )

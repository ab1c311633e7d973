"""The feeds of the frames: their tree, and the pose of one frame in another (``pose:REFERENCE>FRAME``)."""

from __future__ import annotations

from typing import Any

from typing_extensions import override

from bridge.config.model import Config
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from bridge.tf.errors import TransformError
from bridge.tf.transform import angles_of
from bridge.web.feeds.feed import Feed
from navigation.frames import FramesError, RobotFrames
from navigation.pose import Pose

PREFIX = "pose:"
FRAMES_SECONDS, POSE_SECONDS = 1.0, 0.2
_MOST_NAME = 255


class FrameFollower:
    """The transforms of all sides, subscribed while they are needed."""

    def __init__(self, host: Host, config: Config) -> None:
        self._host, self._config = host, config
        self._users = 0
        self._frames: RobotFrames | None = None

    @property
    def frames(self) -> RobotFrames:
        """The frames; raises `FramesError` while they are not subscribed."""
        if self._frames is None:
            raise FramesError("the transforms are not subscribed")
        return self._frames

    def grid_frame(self, topic: str, grid: dict[str, Any], most: int) -> Pose:
        """Return a grid frame's pose on the map; raises `FramesError`, including for more than ``most`` cells."""
        width, height = int(grid["info"]["width"]), int(grid["info"]["height"])
        if width * height > most:
            raise FramesError(f"{topic} has {width} x {height} cells; up to {most} are shown")
        return self.frames.on_map(str(grid["header"]["frame_id"]).lstrip("/"))

    def begin(self) -> None:
        """Add a user; subscribe for the first user."""
        self._users += 1
        if self._frames is None:
            section = self._config.navigation
            self._frames = RobotFrames(self._host, section.frame, section.base_frame)
        elif self._users == 1:
            self._frames.listen()

    def end(self) -> None:
        """Remove a user; unsubscribe after the last user."""
        self._users -= 1
        if not self._users:
            self.frames.unsubscribe()


class FrameFeed(Feed):
    """A feed that is computed from the frames periodically."""

    def __init__(self, host: Host, follower: FrameFollower, name: str, seconds: float) -> None:
        super().__init__(name)
        self._host, self._follower, self._seconds = host, follower, seconds
        self._timer: Timer | None = None

    @override
    def open(self) -> None:
        self._follower.begin()
        self._timer = self._host.loop.every(self._seconds, self.refresh)
        self.refresh()

    @override
    def close(self) -> None:
        if self._timer is not None:
            self._timer.close()
        self._follower.end()

    def refresh(self) -> None:
        """Publish the current value."""


class FramesFeed(FrameFeed):
    """``frames``: all frames that have a parent."""

    def __init__(self, host: Host, follower: FrameFollower) -> None:
        super().__init__(host, follower, "frames", FRAMES_SECONDS)

    @override
    def refresh(self) -> None:
        now = self._host.clock.now_ns()
        self.put(
            [
                {
                    "name": info.name,
                    "parent": info.parent,
                    "age": None if info.static else round(max(now - info.newest, 0) / 1e9, 1),
                    "rate": round(info.rate, 1),
                    "parents": sorted(info.parents),
                }
                for info in self._follower.frames.buffer.frames()
            ]
        )


class FramePoseFeed(FrameFeed):
    """The pose of one frame in another, at the newest time for which all frames between the two have data.

    While the pose is unknown, the value is None with the reason. Raises `LookupError` unless the name has two frames.
    """

    def __init__(self, host: Host, follower: FrameFollower, name: str) -> None:
        super().__init__(host, follower, name, POSE_SECONDS)
        self._reference, separator, self._frame = name.removeprefix(PREFIX).partition(">")
        if not separator or not all(0 < len(frame) <= _MOST_NAME for frame in (self._reference, self._frame)):
            raise LookupError(f"{name[:80]!r} is not a pose feed: use pose:REFERENCE>FRAME")

    @override
    def refresh(self) -> None:
        try:
            transform = self._follower.frames.buffer.lookup_transform(self._reference, self._frame)
        except TransformError as err:
            self.put(None, str(err).strip())
            return
        age = (self._host.clock.now_ns() - transform.stamp) / 1e9 if transform.stamp else None
        self.put(
            {
                "position": dict(zip("xyz", (round(part, 4) for part in transform.translation), strict=True)),
                "rotation": dict(zip("xyzw", (round(part, 6) for part in transform.rotation), strict=True)),
                "angles": dict(
                    zip(
                        ("roll", "pitch", "yaw"),
                        (round(part, 5) for part in angles_of(transform.rotation)),
                        strict=True,
                    )
                ),
                "age": None if age is None else round(max(age, 0.0), 2),
            }
        )

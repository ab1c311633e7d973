"""The feed ``pose:REFERENCE>FRAME``: where one frame is in another now."""

from __future__ import annotations

from bridge.cli.frames.tf import angles_of
from bridge.modules.host import Host
from bridge.tf.errors import TransformError
from bridge.web.robot import FrameFeed, FrameFollower

PREFIX = "pose:"
POSE_SECONDS = 0.2
_MOST_NAME = 255


class FramePoseFeed(FrameFeed):
    """At the newest time that all frames between the two have. Raises `LookupError` where its name says no two frames.

    Frames that were just begun to be followed are not known yet: then the reason says so.
    """

    def __init__(self, host: Host, follower: FrameFollower, name: str) -> None:
        super().__init__(host, follower, name, POSE_SECONDS)
        self._reference, parted, self._frame = name.removeprefix(PREFIX).partition(">")
        if not parted or not all(0 < len(each) <= _MOST_NAME for each in (self._reference, self._frame)):
            raise LookupError(f"{name[:80]!r} is no feed of a pose: ask for pose:REFERENCE>FRAME")

    def look(self) -> None:
        """Put the pose of now, or why there is none."""
        try:
            found = self._follower.frames.buffer.lookup_transform(self._reference, self._frame)
        except TransformError as err:
            self.put(None, str(err).strip())
            return
        age = (self._host.clock.now_ns() - found.stamp) / 1e9 if found.stamp else None
        self.put(
            {
                "position": dict(zip("xyz", (round(part, 4) for part in found.translation), strict=True)),
                "rotation": dict(zip("xyzw", (round(part, 6) for part in found.rotation), strict=True)),
                "angles": dict(
                    zip(("roll", "pitch", "yaw"), (round(part, 5) for part in angles_of(found.rotation)), strict=True)
                ),
                "age": None if age is None else round(max(age, 0.0), 2),
            }
        )

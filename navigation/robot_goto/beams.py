"""Where the laser and the base were as a scan was made."""

from __future__ import annotations

from navigation.frames import LATE, Frames, FramesError
from navigation.pose import Pose


def laser_pose(frames: Frames, frame: str) -> Pose:
    """Where a laser is on the base.

    Raises:
        FramesError: that is not known.
    """
    return Pose(0.0, 0.0, 0.0) if frame.lstrip("/") == frames.base_frame else frames.transform(frames.base_frame, frame)


def moved_at(frames: Frames, stamp_ns: int) -> Pose:
    """Where the base was in the odometry's frame, or on the map where there is no odometry.

    Raises:
        FramesError: neither is known.
    """
    try:
        return frames.transform(frames.odom_frame, frames.base_frame, stamp_ns, extrapolate=LATE)
    except FramesError as err:
        try:
            return frames.transform(frames.map_frame, frames.base_frame, stamp_ns, extrapolate=LATE)
        except FramesError:
            raise err from None

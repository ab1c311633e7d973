"""Reasons why a transform is unavailable or was refused: exceptions and codes named as in tf2, and their texts.

The texts of failed lookups are those of tf2 0.7.6 (buffer_core.cpp, cache.cpp), which users search for.
"""

from __future__ import annotations

from enum import StrEnum

from bridge.tf.layout import EMPTY, FUTURE, SINGLE


class TransformError(Exception):
    """A transform is unavailable."""


class LookupError_(TransformError, LookupError):  # noqa: N801, N818  # Python has its own LookupError
    """A frame is unknown, or the frames form a loop."""


class ConnectivityError(TransformError):
    """The frames are in separate trees."""


class ExtrapolationError(TransformError):
    """The requested time is outside the history."""


class InvalidArgumentError(TransformError, ValueError):
    """The lookup is invalid: a name is empty."""


class FrameRefusal(StrEnum):
    """Why a transform was refused. Reasons that begin with TF are those of tf2, as in its log."""

    SELF_TRANSFORM = "TF_SELF_TRANSFORM"
    NO_CHILD_FRAME_ID = "TF_NO_CHILD_FRAME_ID"
    NO_FRAME_ID = "TF_NO_FRAME_ID"
    NAN_INPUT = "TF_NAN_INPUT"
    DENORMALIZED_QUATERNION = "TF_DENORMALIZED_QUATERNION"
    OLD_DATA = "TF_OLD_DATA"
    REPEATED_DATA = "TF_REPEATED_DATA"
    INVALID_STAMP = "INVALID_STAMP"
    FUTURE = "FUTURE"
    TIME_SCALE = "TIME_SCALE"
    TOO_MANY_FRAMES = "TOO_MANY_FRAMES"


_SECOND = 1_000_000_000
LOOP = "The tf tree is invalid because it contains a loop."

CURES = {
    FrameRefusal.SELF_TRANSFORM: "frame_id and child_frame_id are the same",
    FrameRefusal.NO_CHILD_FRAME_ID: "child_frame_id is not set",
    FrameRefusal.NO_FRAME_ID: "frame_id is not set",
    FrameRefusal.NAN_INPUT: "a value is not a number: check its publisher for a division by zero",
    FrameRefusal.DENORMALIZED_QUATERNION: "the rotation's length is not 1: normalize it (0, 0, 0, 1 means no rotation)",
    FrameRefusal.OLD_DATA: "it is older than the history: its publisher's clock is behind or was set back, or a second"
    " publisher uses another clock",
    FrameRefusal.REPEATED_DATA: "the buffer has a transform with this stamp: it was sent twice or arrives by two paths",
    FrameRefusal.INVALID_STAMP: "its stamp is not a valid time",
    FrameRefusal.FUTURE: "its stamp is further ahead of the clock than max_future: synchronize the machines' clocks",
    FrameRefusal.TIME_SCALE: "its stamp is on another time scale: its publisher uses the system clock, and this daemon"
    " the simulation's, or vice versa (use_sim_time)",
    FrameRefusal.TOO_MANY_FRAMES: "there are too many frames: a publisher generates frame names",
}
"""What is wrong, and how to fix it."""


def refusal(reason: FrameRefusal, parent: str, child: str, stamp: int, authority: str) -> str:
    """Return why a transform was refused, as text."""
    link, publisher = f'"{parent}" to "{child}"', f' of "{authority}"' if authority else ""
    return f"{reason}: the transform from {link} at {seconds(stamp):.9f}{publisher}: {CURES[reason]}"


def empty_name(role: str) -> str:
    """Return the error for an empty frame name."""
    return f"Invalid argument passed to lookupTransform argument {role}_frame in tf2 frame_ids cannot be empty"


def unknown_name(name: str, role: str) -> str:
    """Return the error for an unknown frame."""
    return f'"{name}" passed to lookupTransform argument {role}_frame does not exist. '


def connectivity(target: str, source: str) -> str:
    """Return the error for two frames that are not connected."""
    return (
        f"Could not find a connection between '{target}' and '{source}' because they are not part of the same"
        " tree.Tf has two or more unconnected trees."
    )


def extrapolation(asked: int, bound: int, trouble: int, target: str, source: str) -> str:
    """Return the error for a time without data; numbers are rounded as in tf2's texts."""
    between = f", when looking up transform from frame [{source}] to frame [{target}]"
    if trouble == EMPTY:
        return between
    time, other = seconds(asked), seconds(bound)
    if trouble == SINGLE:
        only = f"only time {other:.9f} is in the buffer{between}"
        return f"Lookup would require extrapolation at time {time:.9f}, but {only}"
    ahead, known = ("future", "latest") if trouble == FUTURE else ("past", "earliest")
    return (
        f"Lookup would require extrapolation {seconds(abs(asked - bound)):.9f}s into the {ahead}.  Requested time"
        f" {time:.9f} but the {known} data is at time {other:.9f}{between}"
    )


def seconds(stamp: int) -> float:
    """Convert nanoseconds to seconds, rounded as in tf2."""
    whole, nanoseconds = divmod(stamp, _SECOND)
    return whole + 1e-9 * nanoseconds

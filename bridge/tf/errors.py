"""Why a transform is not to be had, or was refused: errors named as in tf2, and their texts.

The texts of a lookup are those of tf2 0.7.6 (buffer_core.cpp, cache.cpp), which people search for.
"""

from __future__ import annotations

from enum import StrEnum

from bridge.tf.layout import EMPTY, FUTURE, SINGLE


class TransformError(Exception):
    """No transform."""


class LookupError_(TransformError, LookupError):  # noqa: N801, N818  # Python's own LookupError is another
    """A frame is not known, or the frames make a loop."""


class ConnectivityError(TransformError):
    """The frames are in different trees."""


class ExtrapolationError(TransformError):
    """The time lies outside the history."""


class InvalidArgumentError(TransformError, ValueError):
    """A question that has no answer: an empty name."""


class FrameRefusal(StrEnum):
    """Why a transform was not taken up. Those that begin with TF are tf2's own, by the words of its log."""

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
    FrameRefusal.NAN_INPUT: "a value is not a number: look where its publisher divides by zero",
    FrameRefusal.DENORMALIZED_QUATERNION: "the rotation's length is not 1: normalise it (0, 0, 0, 1 is no rotation)",
    FrameRefusal.OLD_DATA: "it is older than the history that is kept before the newest one: its clock is behind, or"
    " was set back, or a second publisher runs on another clock",
    FrameRefusal.REPEATED_DATA: "there is one with this stamp: it was sent twice, or comes by two ways",
    FrameRefusal.INVALID_STAMP: "its stamp is no time",
    FrameRefusal.FUTURE: "its stamp is further ahead of the clock than max_future: set the machines' clocks",
    FrameRefusal.TIME_SCALE: "its stamp is of another time scale: its publisher runs on the machine's clock and this on"
    " the simulation's, or the other way round (use_sim_time)",
    FrameRefusal.TOO_MANY_FRAMES: "there are too many frames: a publisher makes up names",
}
"""What is wrong, and how to mend it."""


def refusal(reason: FrameRefusal, parent: str, child: str, stamp: int, authority: str) -> str:
    """Why a transform was not taken up."""
    return f'{reason}: the transform from "{parent}" to "{child}" at {seconds(stamp):.9f} of "{authority}": {CURES[reason]}'


def empty_name(role: str) -> str:
    """A lookup of a frame without a name."""
    return f"Invalid argument passed to lookupTransform argument {role}_frame in tf2 frame_ids cannot be empty"


def unknown_name(name: str, role: str) -> str:
    """A lookup of an unknown frame."""
    return f'"{name}" passed to lookupTransform argument {role}_frame does not exist. '


def connectivity(target: str, source: str) -> str:
    """There is no way between two frames."""
    return (
        f"Could not find a connection between '{target}' and '{source}' because they are not part of the same"
        " tree.Tf has two or more unconnected trees."
    )


def extrapolation(asked: int, bound: int, trouble: int, target: str, source: str) -> str:
    """Why there is nothing at a time; the numbers are rounded as in tf2's texts."""
    between = f", when looking up transform from frame [{source}] to frame [{target}]"
    if trouble == EMPTY:
        return between
    requested, available = seconds(asked), seconds(bound)
    if trouble == SINGLE:
        return (
            f"Lookup would require extrapolation at time {requested:.9f}, but only time {available:.9f} is in the buffer{between}"
        )
    ahead, known = ("future", "latest") if trouble == FUTURE else ("past", "earliest")
    return (
        f"Lookup would require extrapolation {seconds(abs(asked - bound)):.9f}s into the {ahead}.  Requested time"
        f" {requested:.9f} but the {known} data is at time {available:.9f}{between}"
    )


def seconds(stamp: int) -> float:
    """Nanoseconds as tf2 makes them seconds."""
    whole, nanoseconds = divmod(stamp, _SECOND)
    return whole + 1e-9 * nanoseconds

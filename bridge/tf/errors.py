"""Why a transform is not to be had, or was not taken up; named as tf2 names them."""

from __future__ import annotations

from enum import StrEnum


class TransformError(Exception):
    """No transform."""


class LookupError_(TransformError, LookupError):  # noqa: N801, N818  # Python's own LookupError is another
    """A frame is not known, or the frames make a loop."""


class ConnectivityError(TransformError):
    """The frames are in different trees."""


class ExtrapolationError(TransformError):
    """The time lies outside of what is known."""


class InvalidArgumentError(TransformError, ValueError):
    """A question that has no answer: an empty name."""


class Refusal(StrEnum):
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


CURES = {
    Refusal.SELF_TRANSFORM: "frame_id and child_frame_id are the same",
    Refusal.NO_CHILD_FRAME_ID: "child_frame_id is not set",
    Refusal.NO_FRAME_ID: "frame_id is not set",
    Refusal.NAN_INPUT: "a value is not a number: look where its publisher divides by zero",
    Refusal.DENORMALIZED_QUATERNION: "the rotation's length is not 1: normalise it (0, 0, 0, 1 is no rotation)",
    Refusal.OLD_DATA: "it is older than the history that is kept before the newest one: its clock is behind, or was set"
    " back, or a second publisher runs on another clock",
    Refusal.REPEATED_DATA: "there is one with this stamp: it was sent twice, or comes by two ways",
    Refusal.INVALID_STAMP: "its stamp is no time",
    Refusal.FUTURE: "its stamp is further ahead of the clock than max_future: set the machines' clocks",
    Refusal.TIME_SCALE: "its stamp is of another time scale: its publisher runs on the machine's clock and this on the"
    " simulation's, or the other way round (use_sim_time)",
    Refusal.TOO_MANY_FRAMES: "there are too many frames: a publisher makes up names",
}
"""What is wrong, and how to mend it."""

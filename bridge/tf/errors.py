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

"""Transforms between frames (`yarp/math/FrameTransform.h`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from yarp_compat.dev.fields import INT8
from yarp_compat.dev.structure import Structure


@dataclass
class FrameTransform(Structure):
    """Where a frame is in its parent's.

    Attributes:
        src_frame_id: the parent.
        dst_frame_id: the child.
        timestamp: seconds since 1970.
        isStatic: 1 for one that does not expire, else 0.
        tX: metres.
        tY: metres.
        tZ: metres.
        qX: the rotation's quaternion.
        qY: the rotation's quaternion.
        qZ: the rotation's quaternion.
        qW: the rotation's quaternion.
    """

    TYPE = "yarp/frameTransform"
    src_frame_id: str = ""
    dst_frame_id: str = ""
    timestamp: float = 0.0
    isStatic: Annotated[int, INT8] = 0
    tX: float = 0.0
    tY: float = 0.0
    tZ: float = 0.0
    qX: float = 0.0
    qY: float = 0.0
    qZ: float = 0.0
    qW: float = 1.0

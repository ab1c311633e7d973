"""YARP's navigation and frame transform services as its .thrift files declare them, as far as transcripts go."""

from __future__ import annotations

from dataclasses import dataclass, field

from yarp_compat.dev.fields import Structure
from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.inavigation2d import INavigation2DMsgs
from yarp_compat.dev.localization2d import ILocalization2DMsgs
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.dev.service import Service, rpc


class Transforms(Service):
    @rpc
    def setTransformRPC(self, transform: FrameTransform) -> ReturnValue: ...


class All(INavigation2DMsgs, IMap2DMsgs, ILocalization2DMsgs, Transforms):
    """Every method, so that a transcript's requests need no sorting."""


@dataclass
class Tree(Structure):
    """What the frame transform server sends all the time."""

    retvalue: ReturnValue = field(default_factory=ReturnValue)
    transforms: list[FrameTransform] = field(default_factory=list)

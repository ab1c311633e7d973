"""The navigation and frame transform services of YARP's .thrift files that the transcripts contain."""

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
    """All methods, so that a transcript's requests need not be sorted by service."""


@dataclass
class Tree(Structure):
    """The message that the frame transform server streams."""

    retvalue: ReturnValue = field(default_factory=ReturnValue)
    transforms: list[FrameTransform] = field(default_factory=list)

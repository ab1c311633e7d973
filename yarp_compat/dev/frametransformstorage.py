"""The services of a server of transforms (`frameTransformStorageMsgs.thrift`), and the names of its ports.

Each clients' port has a server of its own: one sets, one gives. What is given is also streamed, all of it each time.
(`frameTransformSet_nws_yarp`, `frameTransformGet_nws_yarp` of YARP 3.6 to 4.0)
"""

from __future__ import annotations

from dataclasses import dataclass, field

from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.dev.service import Service, rpc
from yarp_compat.dev.structure import Structure

SERVER, CLIENT = "/frameTransformServer", "/frameTransformClient"
SET, GET = "/frameTransformSet_nws_yarp/thrift", "/frameTransformGet_nws_yarp/thrift"
STREAM = "/frameTransformGet_nws_yarp/tf:o"


class FrameTransformStorageSetRPC(Service):
    """Takes transforms."""

    @rpc
    def setTransformsRPC(self, transforms: list[FrameTransform]) -> ReturnValue:
        """Take several; the newest of each pair of frames counts."""
        raise NotImplementedError

    @rpc
    def setTransformRPC(self, transform: FrameTransform) -> ReturnValue:
        """Take one."""
        raise NotImplementedError

    @rpc
    def deleteTransformRPC(self, src: str, dst: str) -> ReturnValue:
        """Forget what is between two frames, either way round; ``*`` is any frame."""
        raise NotImplementedError

    @rpc
    def clearAllRPC(self) -> ReturnValue:
        """Forget all."""
        raise NotImplementedError


class FrameTransformStorageGetRPC(Service):
    """Gives transforms."""

    @rpc
    def getTransformsRPC(self) -> tuple[ReturnValue, list[FrameTransform]]:
        """All that are known and have not expired."""
        raise NotImplementedError


@dataclass
class Transforms(Structure):
    """What a server streams: YARP's ``return_getAllTransforms``."""

    retvalue: ReturnValue = field(default_factory=ReturnValue)
    transforms_list: list[FrameTransform] = field(default_factory=list)

"""Transforms between frames (`yarp/math/FrameTransform.h`), and the services of a transform server.

The services are those of `frameTransformStorageMsgs.thrift`; the ports have YARP's names.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Annotated

from yarp_compat.dev.fields import INT8, Structure
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.dev.service import Service, rpc
from yarp_compat.overriding import override
from yarp_compat.wire import tags
from yarp_compat.wire.elements import ElementReader, ElementWriter

_FIELDS = 11
_HEAD = struct.Struct("<4i")  # the list's code and count, the first string's tag and length
_NEXT = struct.Struct("<2i")
_TAIL = struct.Struct("<id ib" + " id" * 7)


@dataclass
class FrameTransform(Structure):
    """The pose of the frame ``dst_frame_id`` in ``src_frame_id``: meters, seconds; a static pose does not expire."""

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

    @override
    def _write(self, out: ElementWriter) -> None:
        """Write all fields at once, because servers send hundreds of these a hundred times a second."""
        double = out.profile.float64_tag
        try:
            parent = self.src_frame_id.encode("utf-8", "surrogateescape")
            child = self.dst_frame_id.encode("utf-8", "surrogateescape")
            tail = _TAIL.pack(
                double, self.timestamp, tags.INT8, self.isStatic,
                double, self.tX, double, self.tY, double, self.tZ,
                double, self.qX, double, self.qY, double, self.qZ, double, self.qW,
            )  # fmt: skip
        except (struct.error, TypeError, AttributeError, UnicodeEncodeError):
            super()._write(out)  # raises an error that names the invalid field
            return
        head = _HEAD.pack(tags.LIST, _FIELDS, tags.STRING, len(parent))
        out.block(b"".join((head, parent, _NEXT.pack(tags.STRING, len(child)), child, tail)))

    @override
    def _read(self, source: ElementReader) -> None:
        """Read the usual layout at once, and equivalent layouts field by field."""
        at, data = source.at, source.data
        try:
            first = _HEAD.unpack_from(data, at)
            middle = at + _HEAD.size + first[3]
            second = _NEXT.unpack_from(data, middle)
            end = middle + _NEXT.size + second[1]
            tail = _TAIL.unpack_from(data, end)
            double = source.profile.float64_tag
            if (
                source.unit
                or not source.left
                or first[:3] != (tags.LIST, _FIELDS, tags.STRING)
                or min(first[3], second[1]) < 0
                or second[0] != tags.STRING
                or tail[0:2:2] + tail[4::2] != (double,) * 8
                or tail[2] != tags.INT8
            ):
                super()._read(source)
                return
            parent = str(data[at + _HEAD.size : middle], "utf-8", "surrogateescape")
            child = str(data[middle + _NEXT.size : end], "utf-8", "surrogateescape")
        except struct.error:
            super()._read(source)
            return
        source.untagged(_HEAD)
        source.block(end + _TAIL.size - source.at)
        self.src_frame_id, self.dst_frame_id = parent, child
        self.timestamp, self.isStatic = tail[1], tail[3]
        self.tX, self.tY, self.tZ, self.qX, self.qY, self.qZ, self.qW = tail[5::2]


SERVER, CLIENT = "/frameTransformServer", "/frameTransformClient"
SET, GET = "/frameTransformSet_nws_yarp/thrift", "/frameTransformGet_nws_yarp/thrift"
STREAM = "/frameTransformGet_nws_yarp/tf:o"


@rpc
class FrameTransformStorageSetRPC(Service):
    """Sets transforms (the newest between two frames counts), and deletes them in either order; ``*`` is any frame."""

    def setTransformsRPC(self, transforms: list[FrameTransform]) -> ReturnValue: ...
    def setTransformRPC(self, transform: FrameTransform) -> ReturnValue: ...
    def deleteTransformRPC(self, src: str, dst: str) -> ReturnValue: ...
    def clearAllRPC(self) -> ReturnValue: ...


@rpc
class FrameTransformStorageGetRPC(Service):
    """Returns the transforms that have not expired."""

    def getTransformsRPC(self) -> tuple[ReturnValue, list[FrameTransform]]: ...


@dataclass
class AllTransforms(Structure):
    """The message that a server streams: YARP's ``return_getAllTransforms``."""

    retvalue: ReturnValue = field(default_factory=ReturnValue)
    transforms_list: list[FrameTransform] = field(default_factory=list)

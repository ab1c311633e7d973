"""Encodes requests and replies by the rules of YARP's generated code, independently of the code under test."""

from __future__ import annotations

import struct
from typing import Any

from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.fields import VocabEnum
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue
from yarp_compat.sig.matrix import Matrix
from yarp_compat.wire.generation import Generation


def text(value: str) -> bytes:
    return struct.pack("<ii", 4, len(value)) + value.encode()


def vocab(value: str) -> bytes:
    return struct.pack("<i4s", 9, value.encode())


def listed(*elements: bytes) -> bytes:
    return struct.pack("<ii", 256, len(elements)) + b"".join(elements)


class Bytes:
    """The encoding of one generation."""

    def __init__(self, generation: Generation) -> None:
        self.generation = generation
        self.f64 = 20 if generation is Generation.YARP_4 else 10

    def number(self, value: float) -> bytes:
        return struct.pack("<id", self.f64, value)

    def of(self, value: Any) -> bytes:
        match value:
            case bool():
                return vocab("ok" if value else "fail")
            case str():
                return text(value)
            case list() if value and isinstance(value[0], str):
                return struct.pack("<ii", 260, len(value)) + b"".join(text(item)[4:] for item in value)
            case list():
                return listed(*map(self.of, value))
            case float():
                return self.number(value)
            case VocabEnum():
                return vocab(value.text)
            case Matrix():
                size = [struct.pack("<ii", 1, number) for number in (value.rows(), value.cols())]
                numbers = value.numpy().ravel().tolist()
                return listed(
                    *size, struct.pack("<ii", 256 + self.f64, len(numbers)) + struct.pack(f"<{len(numbers)}d", *numbers)
                )
            case OdometryData():
                return listed(*map(self.number, vars(value).values()))
            case ReturnValue():
                return self.outcome(value.code)
            case Map2DLocation():
                return listed(text(value.map_id), *map(self.number, (value.x, value.y, value.theta)),
                              text(value.description))  # fmt: skip
            case Map2DObject():
                pose = (value.x, value.y, value.z, value.roll, value.pitch, value.yaw)
                return listed(text(value.map_id), *map(self.number, pose), text(value.description))
            case Map2DArea():
                corners = [struct.pack("<iidd", 256 + self.f64, 2, point.x, point.y) for point in value.points]
                return listed(text(value.map_id), listed(*corners), text(value.description))
            case Map2DPath():
                return listed(listed(*map(self.of, value.waypoints)), text(value.description))
            case MapGrid2D():
                blobs = [struct.pack("<ii", 12, 6) + cells.tobytes() for cells in (value.occupancy, value.flags)]
                size = [struct.pack("<ii", 1, number) for number in (value.width(), value.height())]
                place = map(self.number, (*value.getOrigin(), value.resolution))
                return listed(*size, *place, text(value.name), struct.pack("<ib", 32, 0), *blobs)
        raise TypeError(value)

    def outcome(self, code: ReturnCode) -> bytes:
        if self.generation is Generation.YARP_4:
            return listed(vocab({ReturnCode.OK: "ok", ReturnCode.METHOD_FAILED: "err5"}[code]))
        number = {ReturnCode.OK: 0, ReturnCode.METHOD_FAILED: 5}[code]
        if self.generation is Generation.YARP_3_12:
            return struct.pack("<ii", 1, number)
        if self.generation is Generation.YARP_3_11:
            return struct.pack("<q", number)
        return vocab("ok" if code is ReturnCode.OK else "fail")

    def request(self, name: str, *arguments: Any) -> bytes:
        parts = [vocab(part) if len(part) <= 4 else text(part) for part in name.split("_")]
        return listed(*parts, *map(self.of, arguments))

    def reply(self, outcome: ReturnValue, *results: Any) -> bytes:
        if results or self.generation is Generation.YARP_3_6:
            return listed(self.of(outcome), *map(self.of, results))
        return self.of(outcome)


class Returning:
    """A service of any interface that returns the same results from each call, and stores the arguments."""

    @staticmethod
    def of(interface: type[Any], returned: Any) -> Any:
        class Combined(Returning, interface):  # type: ignore[misc, valid-type]
            pass

        service = Combined()
        service.returned, service.arguments = returned, ()
        return service

    def __getattribute__(self, name: str) -> Any:
        return super().__getattribute__("respond" if name.endswith("_RPC") else name)

    def respond(self, *arguments: Any) -> Any:
        self.arguments = arguments
        if isinstance(self.returned, Exception):
            raise self.returned
        return self.returned

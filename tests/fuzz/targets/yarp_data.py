"""YARP's typed data, and requests and replies of its interfaces, from a peer."""

from __future__ import annotations

import contextlib
import itertools
import logging
import struct
from collections.abc import Sequence
from typing import Any

from tests.fuzz.target import Subject, Target, texts

_NUMBERS = [struct.pack("<i", n) for n in (1, 4, 5, 9, 10, 12, 17, 20, 32, 64, 128, 256, 266, 276, 2**31 - 1, -1)]
_LISTS = [bytes.fromhex("0001000001000000") * n for n in (1, 100, 300)]


def _kinds() -> Sequence[type[Any]]:
    from yarp_compat.dev.basecontrol import OdometryData
    from yarp_compat.dev.frametransform import FrameTransform
    from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
    from yarp_compat.dev.rangefinder import LaserScan2D
    from yarp_compat.dev.returnvalue import ReturnValue
    from yarp_compat.sig.image import FlexImage, ImageMono, ImageRgb
    from yarp_compat.sig.matrix import Matrix, Quaternion
    from yarp_compat.sig.pointcloud import PointCloud, PointCloudXYZ
    from yarp_compat.sig.sound import Sound
    from yarp_compat.sig.vec2d import Vec2D
    from yarp_compat.sig.vector import Vector, VectorFloat, VectorInt, VectorUInt8

    return (
        Vector, VectorFloat, VectorInt, VectorUInt8, Matrix, FlexImage, ImageRgb, ImageMono, PointCloud, PointCloudXYZ,
        Quaternion, Sound, Vec2D, LaserScan2D, OdometryData, Map2DLocation, Map2DArea, Map2DObject, Map2DPath,
        FrameTransform, ReturnValue,
    )  # fmt: skip


def _values() -> Subject:
    """Any typed value in either dialect; accepted ones are written as equivalent bytes."""
    import numpy as np

    from tests.yarp_compat.sig.test_portables import VALUES
    from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud
    from yarp_compat.sig.sound import Sound
    from yarp_compat.wire.errors import WireError
    from yarp_compat.wire.profile import Profile

    kinds = _kinds()
    profiles = (Profile.YARP3, Profile.YARP4, None)

    def parse(data: bytes) -> None:
        if len(data) < 2:
            return
        kind, profile = kinds[data[0] % len(kinds)], profiles[data[1] % 3]
        value = kind.from_bytes(data[2:], profile)
        for again in Profile:
            written = value.to_bytes(again)
            assert kind.from_bytes(written, again).to_bytes(again) == written
        repr(value)

    sound = Sound()
    sound.resize(5, 2)
    sound.add_marker("go", 1)
    clouds = [PointCloud.of(np.zeros(3, layout)) for layout in LAYOUTS.values()]
    samples = [*VALUES.values(), sound, *clouds]
    seeds = []
    for number, place, sample in itertools.product(range(len(kinds)), (0, 1), samples):
        data = bytes([number, place]) + sample.to_bytes(Profile("yarp4" if place else "yarp3"))
        with contextlib.suppress(WireError):
            parse(data)
            seeds.append(data)
    return Subject(parse, seeds, (WireError,), [*_NUMBERS, *_LISTS])


def _typed() -> Subject:
    """Typed values as a line on a text carrier."""
    from tests.yarp_compat.sig.test_portables import VALUES
    from yarp_compat.wire.errors import WireError

    kinds = [kind for kind in _kinds() if "PointCloud" not in kind.__name__]

    def parse(data: bytes) -> None:
        value = kinds[data[0] % len(kinds) if data else 0]()
        value.from_text(data[1:].decode("utf-8", "surrogateescape"))
        value.to_text()

    seeds = [
        bytes([number]) + sample.to_text().encode()
        for number, kind in enumerate(kinds)
        for sample in VALUES.values()
        if isinstance(sample, kind)
    ]
    return Subject(parse, seeds, (WireError,), texts("(", ")", "{", "}", "[rgb]", "1e999", "nan", '"', "\\", ",", "-"))


def _requests() -> Subject:
    """Requests to a server with all navigation methods, and replies to its clients."""
    from tests.yarp_compat.dev.interfaces import All
    from tests.yarp_compat.dev.test_transcripts import RECORDED, exchanges
    from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue
    from yarp_compat.dev.server import Server
    from yarp_compat.dev.service import read_version, version_end
    from yarp_compat.wire.errors import WireError
    from yarp_compat.wire.generation import Generation, Generations

    class Done(All):
        def __getattribute__(self, name: str) -> Any:
            if name.endswith("RPC"):
                return lambda *_: ReturnValue(ReturnCode.OK)
            return super().__getattribute__(name)

    logging.getLogger("yarp_compat").setLevel(logging.CRITICAL)
    calls = list(All.calls().values())
    generations = list(Generation)

    def parse(data: bytes) -> None:
        if len(data) < 3:
            return
        generation, payload = generations[data[0] % 4], data[3:]
        assert Server(Done(), Generations(generation)).answer(payload, "/peer")
        call = calls[data[2] % len(calls)]
        if data[1] % 2:
            read_version(payload)
            version_end(payload)
        else:
            reply = call.read_reply(payload, generation)
            assert reply.size <= len(payload)
            call.reply(reply.results, reply.generation)

    seeds = []
    for name, generation in RECORDED.items():
        kind = generations.index(generation)
        for number, (request, reply) in enumerate(exchanges(name)):
            seeds += [bytes([kind, number % 2, 0]) + request, bytes([kind, 0, number % len(calls)]) + reply]
    return Subject(parse, seeds, (WireError,), [*_NUMBERS, *_LISTS, *texts("help", "RPC", "_", "fail", "ok\0\0")])


def _navigation() -> Subject:
    """Requests and plain commands to a navigator's port, and requests to a localizer's; devices answer both."""
    from tests.yarp_compat.dev.test_inavigation2d import CALLS
    from tests.yarp_compat.dev.test_robotgoto_commands import Goto
    from yarp_compat.dev.inavigation2d import INavigation2DMsgs
    from yarp_compat.dev.localization2d import Localization2DServer
    from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue
    from yarp_compat.dev.server import Server
    from yarp_compat.wire.binary import encode
    from yarp_compat.wire.generation import Generation, Generations
    from yarp_compat.wire.profile import Profile

    class Device:
        def __getattr__(self, name: str) -> Any:
            return lambda *_: ReturnValue(ReturnCode.OK)

    logging.getLogger("yarp_compat").setLevel(logging.CRITICAL)
    generations = list(Generation)

    def parse(data: bytes) -> None:
        if data:
            service = Goto() if data[0] & 4 else Localization2DServer(Device())
            assert Server(service, Generations(generations[data[0] % 4])).answer(data[1:], "/peer")

    requests = (["set", "linear_tol", 0.05], ["approach", 1, 2.0, 3], ["get", "navigation_status"], ["reset_params"])
    seeds = [
        bytes([7 if kind is INavigation2DMsgs else 3]) + kind.calls()[name].request(payload, Profile.YARP4)
        for kind, name, payload, _ in CALLS
    ]
    seeds += [bytes([4]) + encode(request, Profile.YARP3) for request in requests]
    return Subject(parse, seeds, (), [*_NUMBERS, *_LISTS, *texts("help", "set", "obstacle_stop", "ok\0\0", "glob")])


TARGETS = (
    Target("yarp_values", 40_000, _values),
    Target("yarp_value_text", 10_000, _typed),
    Target("yarp_requests", 25_000, _requests),
    Target("yarp_navigation", 5_000, _navigation),
)

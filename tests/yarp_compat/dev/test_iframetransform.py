"""IFrameTransform: every method in the encoding of every generation; the tree of frames and its matrices."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from tests.yarp_compat.dev.test_transcripts import exchanges, parse_request
from yarp_compat.dev.frametransform import (
    AllTransforms,
    FrameTransform,
    FrameTransformStorageGetRPC,
    FrameTransformStorageSetRPC,
)
from yarp_compat.dev.frametree import FrameTree, TransformError, angles_of, inverse, of_angles, transform_of
from yarp_compat.dev.iframetransform import IFrameTransform
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.server import Server
from yarp_compat.os.data.stdvector import BVector, SVector
from yarp_compat.sig.matrix import Matrix, Quaternion
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile


class TransformSetter(FrameTransformStorageSetRPC):
    def __init__(self, kept: list[FrameTransform]) -> None:
        super().__init__()
        self.kept = kept

    def setTransformsRPC(self, transforms: list[FrameTransform]) -> ReturnValue:
        self.kept.extend(transforms)
        return OK

    def setTransformRPC(self, transform: FrameTransform) -> ReturnValue:
        return self.setTransformsRPC([transform])

    def deleteTransformRPC(self, src: str, dst: str) -> ReturnValue:
        matching = [t for t in self.kept if {t.src_frame_id, t.dst_frame_id} == {src, dst}]
        if not matching:
            raise CallFailed
        self.kept.remove(matching[0])
        return OK

    def clearAllRPC(self) -> ReturnValue:
        self.kept.clear()
        return OK


class TransformGetter(FrameTransformStorageGetRPC):
    def __init__(self, kept: list[FrameTransform]) -> None:
        super().__init__()
        self.kept = kept

    def getTransformsRPC(self) -> tuple[ReturnValue, list[FrameTransform]]:
        return OK, self.kept


class Wire:
    """A channel that calls a server directly."""

    def __init__(self, server: Server, generation: Generation) -> None:
        self.server, self.generation = server, generation
        self.requests: list[bytes] = []

    def request(self, payload: bytes, parse: Callable[[Buffer], int]) -> Buffer:
        self.requests.append(payload)
        reply = self.server.answer(payload, "/client")
        assert parse(reply) == len(reply)
        return reply


class Local(IFrameTransform):
    """The interface over direct channels; while ``away`` is set, the server cannot be reached.

    ``refusal`` is the outcome with which the server refuses to send the tree, if any.
    """

    def __init__(self, generation: Generation) -> None:
        self.kept: list[FrameTransform] = []
        self.away = False
        self.refusal: ReturnCode | None = None
        self.wires = [
            Wire(Server(service(self.kept), Generations(generation)), generation)
            for service in (TransformSetter, TransformGetter)
        ]
        self.setter, self.getter = (
            FrameTransformStorageSetRPC(self.wires[0]),
            FrameTransformStorageGetRPC(self.wires[1]),
        )

    def tree(self) -> FrameTree:
        if self.away:
            raise ConnectionResetError
        if self.refusal is not None:
            raise CallFailed(self.refusal)
        return FrameTree(self.getter.getTransformsRPC()[1])

    def send(self, transforms: list[FrameTransform]) -> ReturnValue:
        return self.setter.setTransformRPC(transforms[0])

    def remove(self, first: str, second: str) -> ReturnValue:
        if self.away:
            raise WireError("not a reply")
        return self.setter.deleteTransformRPC(first, second)

    def remove_all(self) -> ReturnValue:
        return self.setter.clearAllRPC()

    def wait_until(self, known: Callable[[FrameTree], bool], timeout: float) -> bool:  # noqa: ARG002
        return known(self.tree())


@pytest.fixture(params=list(Generation), ids=lambda generation: generation.value)
def frames(request: pytest.FixtureRequest) -> Local:
    return Local(request.param)


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    matrix = of_angles(0.0, 0.0, yaw)
    matrix[:3, 3] = x, y, z
    return matrix


BASE, LASER = pose(1.0, 2.0, 3.0, math.pi / 2), pose(0.5, 0.0, 0.0)


def with_transforms(frames: Local) -> Local:
    """Set a base on the map, and a laser and a camera on the base."""
    assert frames.setTransform("base", "map", Matrix(BASE))
    assert frames.setTransformStatic("laser", "base", Matrix(LASER))
    assert frames.setTransform("camera", "base", Matrix(pose(0.0, 0.0, 1.0)))
    return frames


def test_poses_are_returned_in_every_direction(frames: Local) -> None:
    with_transforms(frames)
    assert [(t.src_frame_id, t.dst_frame_id, t.isStatic) for t in frames.kept] == [
        ("map", "base", 0),
        ("base", "laser", 1),
        ("base", "camera", 0),
    ]
    matrix = Matrix()
    for target, source, want in (
        ("laser", "map", BASE @ LASER),
        ("map", "laser", inverse(BASE @ LASER)),
        ("laser", "camera", pose(0.5, 0.0, -1.0)),
        ("anything", "anything", np.eye(4)),
    ):
        assert frames.getTransform(target, source, matrix)
        np.testing.assert_allclose(matrix.numpy(), want, atol=1e-12)
    assert frames.getTransform("laser", "nowhere", matrix).code is ReturnCode.METHOD_FAILED


def test_queries_return_results_as_in_4_and_as_in_3(frames: Local) -> None:
    with_transforms(frames)
    truth, text, ids = BVector(), SVector(), SVector()
    for target, source, want in (("laser", "camera", True), ("laser", "moon", False), ("moon", "moon", True)):
        assert frames.canTransform(target, source, truth)
        assert truth == [want]
        assert frames.canTransform(target, source) is want
    for name, want in (("map", True), ("laser", True), ("moon", False)):
        assert frames.frameExists(name, truth)
        assert truth == [want]
        assert frames.frameExists(name) is want
    assert frames.getAllFrameIds(ids)
    assert ids == ["map", "base", "laser", "camera"]
    assert frames.getParent("laser", text)
    assert text == ["base"]
    assert frames.getAllFrameIds() == tuple(ids)
    assert (frames.getParent("laser"), frames.getParent("map")) == ("base", "unknown")
    assert frames.getParent("map", text).code is ReturnCode.METHOD_FAILED
    assert frames.allFramesAsString(text)
    assert text[0].startswith(
        "map -> base \n tran: 1.000000 2.000000 3.000000 \n rot quaternion: 0.000000 0.000000 0.70"
    )
    assert frames.allFramesAsString() == text[0]


def test_points_poses_and_rotations_are_transformed(frames: Local) -> None:
    with_transforms(frames)
    out = Vector()
    assert frames.transformPoint("laser", "map", Vector([1.0, 0.0, 0.0]), out)
    np.testing.assert_allclose(out, [1.0, 3.5, 3.0], atol=1e-12)
    assert frames.transformPose("laser", "map", Vector([1.0, 0.0, 0.0, 0.1, 0.2, 0.3]), out)
    np.testing.assert_allclose(out, [1.0, 3.5, 3.0, 0.1, 0.2, 0.3 + math.pi / 2], atol=1e-12)
    turned = Quaternion()
    assert frames.transformQuaternion("laser", "map", Quaternion(0.0, 0.0, 0.6, 0.8), turned)
    np.testing.assert_allclose((turned.z(), turned.w()), (0.989949, 0.141421), atol=1e-6)
    assert not frames.transformPoint("laser", "map", Vector(2), out)
    assert not frames.transformPose("laser", "map", Vector(5), out)
    assert not frames.transformPoint("moon", "map", Vector(3), out)
    assert not frames.transformQuaternion("laser", "map", Quaternion(0.0, 0.0, 0.0, 0.0), turned)


def test_conflicting_transforms_are_rejected(frames: Local) -> None:
    with_transforms(frames)
    assert frames.setTransform("base", "map", Matrix(LASER)), "the same parent and child again are an update"
    assert not frames.setTransform("laser", "map", Matrix(LASER)), (
        "other transforms already define the laser's pose on the map"
    )
    assert not frames.setTransform("map", "map", Matrix(LASER))
    assert not frames.setTransformStatic("laser", "base", Matrix(LASER))
    assert not frames.setTransformStatic("map", "laser", Matrix(LASER))
    assert not frames.setTransform("new", "map", Matrix(3, 3))
    assert len(frames.kept) == 4


def test_transforms_are_deleted_cleared_and_awaited(frames: Local) -> None:
    with_transforms(frames)
    assert frames.waitForTransform("laser", "map", 0.1)
    assert frames.deleteTransform("map", "base")
    assert frames.deleteTransform("map", "base").code in (ReturnCode.METHOD_FAILED, ReturnCode.GENERIC)
    assert not frames.waitForTransform("laser", "map", 0.1)
    assert frames.clear()
    assert not frames.kept


def test_an_unreachable_server_gives_a_communication_error(frames: Local) -> None:
    with_transforms(frames).away = True
    away = ReturnCode.COMMUNICATION
    assert frames.getTransform("laser", "map", Matrix()).code is away
    assert frames.setTransform("base", "map", Matrix(BASE)).code is away
    assert frames.waitForTransform("laser", "map", 0.1).code is away
    assert frames.deleteTransform("laser", "map").code is away
    assert frames.canTransform("laser", "map") is None
    assert frames.frameExists("map", BVector()).code is away


def test_a_refusal_of_the_server_is_returned(frames: Local) -> None:
    refusal = with_transforms(frames).refusal = ReturnCode.NOT_READY
    assert frames.getTransform("laser", "map", Matrix()).code is refusal
    assert frames.waitForTransform("laser", "map", 0.1).code is refusal
    assert frames.canTransform("laser", "map") is None


def test_requests_equal_those_of_the_real_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """The recorded client is frameTransformClient of YARP 4.0 with ``setTransform`` and ``setTransformStatic``."""
    seen = 0
    for request, reply in exchanges("frame-transform.txt"):
        name, call, arguments = parse_request(request, Profile.YARP4)
        if call is None:
            continue
        frames, given = Local(Generation.YARP_4), arguments[0]
        monkeypatch.setattr("yarp_compat.dev.iframetransform.now", lambda given=given: given.timestamp)
        ask = frames.setTransformStatic if given.isStatic else frames.setTransform
        matrix = Matrix(FrameTree([given]).pose(given.dst_frame_id, given.src_frame_id))
        assert name == "setTransformRPC"
        assert ask(given.dst_frame_id, given.src_frame_id, matrix)
        assert frames.wires[0].requests == [request]
        assert frames.wires[0].server.answer(request, "/client") == reply
        seen += 1
    assert seen == 2


def test_fast_and_field_by_field_decoding_agree() -> None:
    given = FrameTransform("äther", "", 1.5, 1, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.9)
    for profile in Profile:
        payload = given.to_bytes(profile)
        assert FrameTransform.from_bytes(payload, profile) == given
        for size in range(len(payload)):
            with pytest.raises(WireError):
                FrameTransform.from_bytes(payload[:size], profile)
        static = payload.rindex(b"\x20\0\0\0\x01")
        with pytest.raises(WireError, match="isStatic"):
            FrameTransform.from_bytes(payload[:static] + b"\x63" + payload[static + 1 :], profile)
    by_hand = ["map", "base", 1, 0, 1, 2, 3, 0, 0, 0, 1]  # integers, as users type them
    read = FrameTransform()
    read.from_values(by_hand)
    assert (read.dst_frame_id, read.tZ, read.qW) == ("base", 3.0, 1.0)
    for wrong in ("no number", None):
        bad = FrameTransform("a", "b", 0.0)
        bad.tX = wrong  # type: ignore[assignment]
        with pytest.raises(WireError, match="tX"):
            bad.to_bytes()
    tree = AllTransforms(transforms_list=[given, given])
    assert AllTransforms.from_bytes(tree.to_bytes(Profile.YARP4), Profile.YARP4) == tree


def test_a_loop_and_two_parents_are_handled() -> None:
    loop = FrameTree([transform_of("a", "b", LASER, 0.0), transform_of("b", "a", LASER, 0.0)])
    assert loop.connected("a", "b")
    with pytest.raises(TransformError, match="unknown frame 'c'; known frames: b, a"):
        loop.pose("a", "c")
    tree = FrameTree([transform_of("x", "first", LASER, 0.0), transform_of("x", "second", BASE, 0.0)])
    assert tree.parent("x") == "first"
    with pytest.raises(TransformError, match="not connected"):
        tree.pose("x", "second")


@pytest.mark.parametrize("seed", range(20))
def test_matrices_angles_and_quaternions_agree(seed: int) -> None:
    chance = np.random.default_rng(seed)
    angles = chance.uniform(-1.0, 1.0, 3) * (math.pi, math.pi / 2, math.pi)
    matrix = of_angles(*angles)
    np.testing.assert_allclose(angles_of(matrix), angles, atol=1e-9)
    turned = Quaternion()
    turned.fromRotationMatrix(matrix)
    np.testing.assert_allclose(turned.toRotationMatrix4x4(), matrix, atol=1e-12)
    np.testing.assert_allclose(inverse(matrix) @ matrix, np.eye(4), atol=1e-12)


@pytest.mark.parametrize(("pitch", "yaw"), [(math.pi / 2, -0.4), (-math.pi / 2, 0.4)])
def test_angles_at_the_singularity_reproduce_the_matrix(pitch: float, yaw: float) -> None:
    matrix = np.round(of_angles(0.0, pitch, yaw), 15)
    matrix[2, 0] = -math.copysign(1.0, pitch)
    angles = angles_of(matrix)
    assert angles[0] == 0.0
    np.testing.assert_allclose(of_angles(*angles), matrix, atol=1e-9)

"""The bytes of typed values recorded from real YARP, encoded and decoded, in both dialects."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import yarp_compat as yarp
from tests.yarp_compat.portables import PORTABLES, TYPED
from yarp_compat.dev.basecontrol import MobileBaseVelocity, OdometryData
from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue
from yarp_compat.sig.image import FlexImage, Image, ImageMono, ImageRgb
from yarp_compat.sig.matrix import Matrix, Quaternion
from yarp_compat.sig.pointcloud import PointCloud
from yarp_compat.sig.sound import Sound
from yarp_compat.sig.vec2d import Vec2D
from yarp_compat.sig.vector import Vector, VectorFloat, VectorInt
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile


def mono() -> ImageMono:
    image = ImageMono()
    image.resize(3, 2)
    image.setPixel(0, 0, 1)
    image.setPixel(2, 1, 9)
    return image


def rgb() -> ImageRgb:
    image = ImageRgb()
    image.resize(2, 1)
    image.pixel(0, 0).r = 255
    return image


def grid(*, zipped: bool) -> MapGrid2D:
    flags = [[4, 1, 2, 3, 0], [0, 0, 0, 0, 5]]
    occupancy = [[100, 0, 0, 0, 0], [0, 0, 0, 0, 255]]
    grid = MapGrid2D.of(flags, occupancy, name="m1", resolution=0.05, origin=(-0.1, -0.05, 0))
    grid.enable_map_compression_over_network(zipped)
    return grid


VALUES: dict[str, Portable] = {
    "sig::Vector(3)": Vector([1, 2, 3]),
    "sig::Vector(0)": Vector(),
    "VectorOf<int>(2)": VectorInt([1, 2]),
    "VectorOf<float>(2)": VectorFloat([1, 2]),
    "sig::Matrix eye(2)": Matrix(2, 2).eye(),
    "ImageOf<PixelMono> 3x2": mono(),
    "ImageOf<PixelRgb> 2x1": rgb(),
    "ReturnValue": ReturnValue(ReturnCode.OK),
    "ReturnValue#2": ReturnValue(ReturnCode.METHOD_FAILED),
    "ReturnValue#3": ReturnValue(ReturnCode.UNINITIALIZED),
    "Map2DLocation": Map2DLocation("map1", 1, 2, 90, "desc"),
    "Map2DObject": Map2DObject("map1", 1, 2, 3, 4, 5, 6, "d"),
    "Map2DArea": Map2DArea("map1", [Vec2D(0, 0), Vec2D(1, 0), Vec2D(1, 1)], "adesc"),
    "Map2DPath": Map2DPath([Map2DLocation("map1", 1, 2, 90, "desc"), Map2DLocation("map1", 3, 4, 0, "")], "pd"),
    "OdometryData": OdometryData(odom_x=1, base_vel_theta=2),
    "MobileBaseVelocity": MobileBaseVelocity(0.1, 0.2, 3),
    "LaserScan2D": LaserScan2D(0, 360, 0.1, 8, Vector([1, 1]), 1),
    "FrameTransform": FrameTransform("map", "odom", 10.0, 1, 1, 2, 3, 0, 0, 0, 1),
    "Quaternion x0y0z0w1": Quaternion(0, 0, 0, 1),
    "MapGrid2D 5x2 uncompressed": grid(zipped=False),
    "MapGrid2D 5x2 compressed": grid(zipped=True),
    "MapGrid2D default ctor": MapGrid2D(),
}


KINDS: list[type[Portable]] = [Vector, VectorInt, Matrix, ImageRgb, Sound, LaserScan2D, *PointCloud.__subclasses__()]


def of_yarp3(data: bytes) -> bytes:
    """Convert YARP 4's bytes to YARP 3's, which have other tags for floats; not for outcomes of calls."""
    if data[:2] == b"\x0a\x01":
        return b"\x80" + data[1:]
    return re.sub(rb"\x14([\x00\x01]\x00\x00)", b"\x0a\\1", data)


@pytest.mark.parametrize("name", VALUES)
def test_values_have_the_bytes_of_yarp_4(name: str) -> None:
    value, data = VALUES[name], PORTABLES[name]
    assert value.to_bytes(Profile.YARP4) == data
    assert b"".join(value.to_wire(Profile.YARP4)) == data
    assert type(value).from_bytes(data, Profile.YARP4) == value


@pytest.mark.parametrize("name", [name for name in VALUES if "ReturnValue" not in name])
def test_values_have_the_bytes_of_yarp_3(name: str) -> None:
    value, data = VALUES[name], of_yarp3(PORTABLES[name])
    assert value.to_bytes(Profile.YARP3) == data
    assert type(value).from_bytes(data, Profile.YARP3) == value


def kind_of(name: str) -> type[Portable]:
    if name.startswith("Flex"):
        return FlexImage
    name = name.removesuffix("Empty")
    return ImageRgb if name == "Image" else next(kind for kind in KINDS if kind.__name__ == name)


@pytest.mark.parametrize("name", TYPED)
def test_values_have_the_bytes_of_yarp_3_12_3(name: str) -> None:
    """Re-encoded, the bytes are the same, apart from the 1 that 3.10 to 3.12 write after an image's quantum."""
    data, kind = TYPED[name], kind_of(name)
    value = kind.from_bytes(data, Profile.YARP3)
    if isinstance(value, Image):
        assert data[42:44] == b"\1\0"
        data = data[:42] + b"\0\0" + data[44:]
    assert value.to_bytes(Profile.YARP3) == data
    assert kind.from_bytes(value.to_bytes(Profile.YARP4), Profile.YARP4) == value


def test_values_of_yarp_3_12_3_are_read_with_their_content() -> None:
    def read(name: str) -> Any:
        return kind_of(name).from_bytes(TYPED[name])

    assert list(read("Vector")) == [0.5, 1.5, 2.5]
    assert list(read("VectorInt")) == [0, -1, -2]
    assert read("Matrix").numpy().tolist() == [[0, 1, 2], [10, 11, 12]]
    assert read("ImageRgb").numpy().tolist() == [[[x, y, 9] for x in range(3)] for y in range(2)]
    assert read("Flex_rgb.").numpy().dtype == np.float32
    assert read("Sound").numpy().tolist() == [[0, 1, 2], [-10, -9, -8]]
    assert (list(read("LaserScan2D").scans), read("LaserScan2D").angle_max) == ([1, 2.5], 360)
    assert read("PointCloudXYZNormalRGBA")[1]["curvature"] == (48 + 36) / 4 / 2
    assert read("PointCloudXYZ")[5]["z"] == (5 * 16 + 8) / 4 / 2


@pytest.mark.parametrize("name", VALUES)
def test_dialect_is_recognized(name: str) -> None:
    value = VALUES[name]
    assert type(value).from_bytes(PORTABLES[name]) == value
    assert type(value).from_bytes(value.to_bytes()) == value


@pytest.mark.parametrize("name", VALUES)
def test_values_survive_a_round_trip_as_text(name: str) -> None:
    value = VALUES[name]
    again = type(value)()
    again.from_text(value.to_text())
    assert again == value


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize("profile", Profile)
def test_truncated_or_too_long_bytes_are_refused_and_change_nothing(name: str, profile: Profile) -> None:
    value, other = VALUES[name], type(VALUES[name])()
    before = other.to_bytes(profile)
    data = value.to_bytes(profile)
    for bad in [data[:size] for size in range(len(data))] + [data + b"\0"]:
        with pytest.raises(WireError):
            other.from_wire(bad, profile)
        assert other.to_bytes(profile) == before


@pytest.mark.parametrize("name", VALUES)
def test_values_are_read_and_written_on_a_connection(name: str) -> None:
    """`read` and `write` work as in YARP's classes, also if another value follows."""
    from yarp_compat.wire.elements import ElementReader, ElementWriter

    value = VALUES[name]
    out = ElementWriter(Profile.YARP4)
    out.begin(2)
    assert value.write(out)
    out.string("behind")
    source = ElementReader(out.payload(), Profile.YARP4)
    source.begin()
    again = type(value)()
    assert again.read(source)
    assert again == value
    assert source.string() == "behind"
    assert not again.read(source)
    assert again == value


@pytest.mark.parametrize(
    ("generation", "ok", "failed"),
    [
        (Generation.YARP_3_6, "090000006f6b0000", "090000006661696c"),
        (Generation.YARP_3_11, "0000000000000000", "0500000000000000"),
        (Generation.YARP_3_12, "0100000000000000", "0100000005000000"),
        (Generation.YARP_4, "0001000001000000090000006f6b0000", "00010000010000000900000065727235"),
    ],
)
def test_outcomes_of_calls_have_the_bytes_of_each_generation(generation: Generation, ok: str, failed: str) -> None:
    assert ReturnValue(ReturnCode.OK).to_bytes(generation.profile, generation).hex() == ok
    assert ReturnValue(ReturnCode.METHOD_FAILED).to_bytes(generation.profile, generation).hex() == failed


@pytest.mark.parametrize(
    ("kind", "data", "reason"),
    [
        (Vector, "1401000005000000", "5 elements"),
        (Vector, "14010000ffffff7f", "2147483647 elements"),
        (Vector, "14010000ffffffff", "-1 elements"),
        (Vector, "0901000001000000736574 00", "list of numbers"),
        (VectorInt, "1401000001000000000000000000f83f", "integers"),
        (Matrix, "0001000003000000010000000200000001000000020000001401000001000000000000000000f03f", "1 elements"),
        (Matrix, "00010000030000000100000000000080 01000000000000801401000000000000", "-2147483648"),
        (Quaternion, "1401000001000000000000000000f03f", "four numbers"),
        (Map2DLocation, "0001000001000000040000000100000061", "5 fields"),
    ],
)
def test_errors_name_the_reason(kind: type[Portable], data: str, reason: str) -> None:
    with pytest.raises(WireError, match=reason):
        kind.from_bytes(bytes.fromhex(data), Profile.YARP4)


def test_inconsistent_images_are_refused_before_memory_is_allocated() -> None:
    good = bytearray(rgb().to_bytes())
    for place, value in [(12 + 4, b"\xff\xff\xff\x7f"), (28, b"\x04"), (32, b"\xff\xff\xff\x7f"), (36, b"\xff"),
                         (40, b"\xff\xff\xff\x7f"), (44, b"\xff\xff\xff\x7f"), (52, b"\x10"),
        (56, b"\x07"), (0, b"\1")]:  # fmt: skip
        bad = bytearray(good)
        bad[place : place + len(value)] = value
        for kind in (ImageRgb, FlexImage):
            with pytest.raises(WireError):
                kind.from_bytes(bad)


def test_generated_structures_print_as_in_cpp() -> None:
    """The expected text is the output of YARP 3.12.3 and 4.0."""
    scan = LaserScan2D(-90, 90, 0.1, 10, Vector([0.5, 1.5, 2.5, 3.5]), 1)
    assert scan.toString() == "-90.0 90.0 0.100000000000000005551 10.0 (0.5 1.5 2.5 3.5) 1"


def test_empty_values_are_written_as_in_yarp_and_read() -> None:
    """C++ YARP refuses to read such values."""
    for value in (Vector(), VectorInt(), Matrix(), ImageRgb(), FlexImage(), Map2DArea(), Map2DPath(), LaserScan2D()):
        for profile in Profile:
            assert type(value).from_bytes(value.to_bytes(profile), profile) == value
    assert Vector().to_bytes(Profile.YARP3).hex() == "0a01000000000000"
    assert np.asarray(ImageRgb()).shape == (0, 0, 3)


def test_parts_of_a_matrix_are_read_and_replaced() -> None:
    matrix, out = yarp.Matrix([[1, 2, 3], [4, 5, 6], [7, 8, 9]]), yarp.Matrix()
    assert list(matrix.subrow(1, 1, 2)) == [5, 6]
    assert list(matrix.subcol(1, 2, 2)) == [6, 9]
    assert list(matrix.subrow(1, 2, 2)) == []
    assert matrix.setSubrow(yarp.Vector([0, 0]), 0, 1)
    assert matrix.setSubcol(yarp.Vector([-1]), 2, 0)
    assert not matrix.setSubcol(yarp.Vector([1, 2]), 2, 0)
    assert yarp.submatrix(matrix, out, 1, 2, 0, 1)
    assert out.numpy().tolist() == [[4, 5], [-1, 8]]
    assert not yarp.submatrix(matrix, out, 1, 3, 0, 1)
    assert yarp.removeCols(matrix, out, 0, 2)
    assert out.numpy().tolist() == [[0], [6], [9]]
    assert matrix.removeRows(1, 1).numpy().tolist() == matrix.numpy().tolist() == [[1, 0, 0], [-1, 8, 9]]
    with pytest.raises(IndexError):
        matrix.removeRows(1, 2)


def test_images_are_swapped_and_moved() -> None:
    image, other = yarp.ImageMono(), yarp.ImageMono()
    image.resize(3, 2)
    image.setPixel(1, 1, 7)
    assert image.getPixelAddress(1, 1) - image.getPixelAddress(0, 0) == image.getRowSize() + 1
    assert [bytes(row) for row in image.getRowArray()] == [b"\0\0\0", b"\0\7\0"]
    other.swap(image)
    assert (image.width(), other.getPixel(1, 1)) == (0, 7)
    image.move(other)
    assert (image.getPixel(1, 1), other.width()) == (7, 0)
    with pytest.raises(TypeError):
        image.swap(yarp.ImageRgb())
    with pytest.raises(ValueError, match="flip them"):
        image.setTopIsLowIndex(False)


def test_data_fills_the_elements() -> None:
    """The bindings' example_enc.py does this: ``ienc.getEncoders(encs.data())``."""
    vector, matrix = yarp.Vector.from_bytes(yarp.Vector([1, 2]).to_bytes()), Matrix([[1, 2], [3, 4]]).transposed()
    vector.data()[0] = 7
    matrix.data()[1] = 9
    assert list(vector) == [7, 2]
    assert matrix.numpy().tolist() == [[1, 9], [2, 4]]

"""Images of every pixel code: their bytes, their memory, and their conversion when read into another class."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.yarp_compat.portables import TYPED
from yarp_compat.sig.image import (
    FlexImage,
    Image,
    ImageBgr,
    ImageFloat,
    ImageHsv,
    ImageInt,
    ImageMono,
    ImageMono16,
    ImageRgb,
    ImageRgba,
    ImageRgbFloat,
)  # fmt: skip
from yarp_compat.sig.pixels import PIXELS, PixelCode, PixelRgb, convert, format_of
from yarp_compat.sig.vector import Vector
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

CODES = [code for code in PixelCode if code != PixelCode.INVALID]


def picture(code: int, width: int, height: int, quantum: int = 0) -> FlexImage:
    image = FlexImage()
    image.setPixelCode(code)
    if quantum:
        image.setQuantum(quantum)
    image.resize(width, height)
    pixels = image.numpy()
    pixels[...] = np.arange(pixels.size).reshape(pixels.shape) % 120
    return image


@given(st.sampled_from([*CODES, -1, -5]), st.integers(0, 9), st.integers(0, 5), st.sampled_from([0, 1, 2, 4, 8, 32]))
def test_every_pixel_code_survives_the_wire(code: int, width: int, height: int, quantum: int) -> None:
    image = picture(code, width, height, quantum)
    for profile in Profile:
        again = FlexImage.from_bytes(image.to_bytes(profile))
        assert again == image
        assert (again.getPixelCode(), again.getRowSize()) == (code, image.getRowSize())
    assert image.getRowSize() % (quantum or 8) == 0
    assert image.getPadding() == image.getRowSize() - width * format_of(code).size
    assert image.getRawImageSize() == image.getRowSize() * height


@pytest.mark.parametrize("code", CODES)
def test_image_is_a_bottle(code: PixelCode) -> None:
    image = picture(code, 3, 2)
    name, pixels, numbers, rows = binary.decode(image.to_bytes(), Profile.YARP3)
    assert (name, type(pixels)) == ("mat", Vocab)
    assert numbers == [image.getPixelSize(), image.getRawImageSize(), 8, 3, 2]
    assert rows == image.tostring()
    assert code == struct.unpack("<i", pixels.encode("latin-1").ljust(4, b"\0"))[0]


def test_an_image_of_3_12_is_read() -> None:
    """The image's header has a 1 after the quantum, which 3.9 reads as upside down and 4.0 as a part of the quantum."""
    data = TYPED["ImageRgb"]
    for image in (ImageRgb.from_bytes(data), FlexImage.from_bytes(data)):
        assert image.numpy()[1].tolist() == [[0, 1, 9], [1, 1, 9], [2, 1, 9]]
        assert (image.getQuantum(), image.getRowSize()) == (8, 16)
        assert image.to_bytes(Profile.YARP3) == data[:42] + b"\0\0" + data[44:]


def test_pixel_codes_have_yarps_names_and_sizes() -> None:
    """The names in `yarp/sig/Image.h`."""
    assert PixelCode.MONO_FLOAT.to_bytes(4, "little") == b"dec\0"
    assert PixelCode.RGB_FLOAT.to_bytes(4, "little") == b"rgb."
    assert {code: format_of(code).size for code in (PixelCode.RGB_INT, PixelCode.HSV, PixelCode.MONO16)} == {
        PixelCode.RGB_INT: 12, PixelCode.HSV: 3, PixelCode.MONO16: 2,
    }  # fmt: skip


def test_official_idiom_reads_into_an_array() -> None:
    """After `setExternal` on a numpy array, reading fills the array."""
    array = np.zeros((240, 320, 3), dtype=np.uint8)
    image = ImageRgb()
    image.resize(320, 240)
    image.setExternal(array.data, array.shape[1], array.shape[0])
    sent = picture(PixelCode.RGB, 320, 240)
    image.from_wire(sent.to_bytes())
    assert np.array_equal(array, sent.numpy())
    image.from_wire(picture(PixelCode.RGB, 320, 240).to_bytes())
    array[:] = 7
    assert image.getPixel(5, 5) == (7, 7, 7)
    other = picture(PixelCode.RGB, 100, 50)
    image.from_wire(other.to_bytes())
    assert (image.width(), image.height()) == (100, 50)
    assert (array == 7).all()


def test_official_idiom_copies_into_an_array() -> None:
    """The code is that of `bindings/python/examples/yarpImage.py`, including its check of the pointer."""
    array = np.ones((480, 640, 3), dtype=np.uint8)
    image = ImageRgb()
    image.resize(640, 480)
    image.setExternal(array, array.shape[1], array.shape[0])
    sent = picture(PixelCode.RGB, 640, 480)
    image.copy(sent)
    assert array.__array_interface__["data"][0] == image.getRawImage().__int__()
    assert np.array_equal(array, sent.numpy())
    mono = ImageMono()
    mono.resize(320, 240)
    mono.setExternal(Vector(320 * 240), 320, 240)  # bindings/python/tests/test_image.py
    assert ImageMono.from_bytes(mono.to_bytes()) == mono


def test_array_is_sent_without_a_copy() -> None:
    array = np.arange(480 * 640 * 3, dtype=np.uint32).astype(np.uint8).reshape(480, 640, 3)
    image = ImageRgb()
    image.setExternal(array, 640, 480)
    _, rows = image.to_wire()
    assert np.shares_memory(np.frombuffer(rows, np.uint8), array)
    array[0, 0, 0] = 99
    assert image.to_bytes()[60] == 99
    assert np.shares_memory(ImageRgb.of(array).numpy(), array)
    assert np.shares_memory(image.numpy(), array)


@pytest.mark.parametrize("width", [4, 5, 6, 7, 8])
def test_arrays_of_any_width_have_no_padding(width: int) -> None:
    """C++ YARP treats an array's rows as padded if the image was resized before; Midspan never does."""
    array = np.arange(width * 3 * 3, dtype=np.uint8).reshape(3, width, 3)
    for resized in (False, True):
        image = ImageRgb()
        if resized:
            image.resize(width, 3)
        image.setExternal(array, width, 3)
        assert np.array_equal(ImageRgb.from_bytes(image.to_bytes()).numpy(), array)


def test_unsuitable_memory_is_refused() -> None:
    image = ImageRgb()
    with pytest.raises(ValueError, match="12 bytes, not 11"):
        image.setExternal(bytes(11), 2, 2)
    with pytest.raises(ValueError, match="contiguous"):
        image.setExternal(np.zeros((4, 4, 3), np.uint8)[:, ::2], 2, 4)
    with pytest.raises(ValueError, match="from an array"):
        ImageRgb.of(np.zeros((4, 4), np.uint8))
    with pytest.raises(ValueError, match="uint16"):
        ImageMono.of(np.zeros((4, 4), np.uint16))
    with pytest.raises(ValueError, match="unknown pixel code"):
        FlexImage().setPixelCode(12345)
    with pytest.raises(IndexError):
        picture(PixelCode.RGB, 2, 2).getPixel(2, 0)


def test_pixels_view_the_image() -> None:
    image = ImageRgb()
    image.resize(4, 3)
    image.pixel(1, 2).g = 200
    image.setPixel(3, 0, (1, 2, 3))
    image.setPixel(0, 0, PixelRgb(4, 5, 6))
    assert image.numpy()[2, 1].tolist() == [0, 200, 0]
    assert (image.pixel(3, 0).b, list(image.access(0, 0))) == (3, [4, 5, 6])
    assert image.safePixel(9, 9) == PixelRgb()
    assert (image.isPixel(3, 2), image.isPixel(4, 2), image.isPixel(-1, 0)) == (True, False, False)
    with pytest.raises(AttributeError, match="only r, g, b"):
        image.pixel(0, 0).a = 1
    depth = ImageFloat()
    depth.resize(2, 2)
    depth.setPixel(1, 1, 2.5)
    assert (depth.pixel(1, 1), depth.getPixel(1, 1), depth.safePixel(5, 5)) == (2.5, 2.5, 0)
    image.zero()
    assert not image.numpy().any()


@pytest.mark.parametrize("kind", PIXELS.values())
def test_pixels_are_created_red_first_for_any_memory_order(kind: Any) -> None:
    pixel = kind(1, 2, 3)
    assert [getattr(pixel, name) for name in ("hsv" if "h" in kind.names else "rgb")] == [1, 2, 3]


def test_read_only_image_is_copied_before_a_change() -> None:
    payload = picture(PixelCode.RGB, 3, 3).to_bytes()
    image = ImageRgb.from_bytes(payload)
    assert not image.numpy().flags.writeable
    image.setPixel(0, 0, (9, 9, 9))
    assert image.getPixel(0, 0) == (9, 9, 9)
    assert payload == picture(PixelCode.RGB, 3, 3).to_bytes()
    writable = ImageRgb.from_bytes(bytearray(payload))
    assert writable.numpy().flags.writeable


@pytest.mark.parametrize(
    ("kind", "source", "pixel", "expected"),
    [
        (ImageMono, PixelCode.RGB, (1, 2, 6), 3),
        (ImageFloat, PixelCode.RGB, (1, 2, 5), pytest.approx(8 / 3)),
        (ImageRgb, PixelCode.MONO, 7, (7, 7, 7)),
        (ImageRgba, PixelCode.BGR, (1, 2, 3), (3, 2, 1, 255)),
        (ImageBgr, PixelCode.RGBA, (1, 2, 3, 4), (3, 2, 1)),
        (ImageMono, PixelCode.MONO_FLOAT, 3.9, 3),
        (ImageMono, PixelCode.MONO_FLOAT, 1e9, 255),
        (ImageMono, PixelCode.MONO_FLOAT, float("nan"), 0),
        (ImageMono16, PixelCode.MONO, 200, 200),
        (ImageMono, PixelCode.MONO16, 0x0102, 2),
        (ImageInt, PixelCode.RGB_SIGNED, (-1, -2, -5), -2),
        (ImageHsv, PixelCode.MONO, 5, (0, 0, 5)),
        (ImageRgbFloat, PixelCode.RGB, (1, 2, 3), (1, 2, 3)),
    ],
)
def test_reading_into_another_class_converts_as_in_yarp(
    kind: type[Image], source: int, pixel: Any, expected: Any
) -> None:
    sent = picture(source, 3, 2)
    sent.setPixel(1, 1, pixel)
    image = kind()
    image.from_wire(sent.to_bytes())
    assert image.getPixelCode() == kind.code
    assert image.getPixel(1, 1) == expected


@pytest.mark.parametrize(("source", "target"), [(PixelCode.HSV, PixelCode.RGB), (PixelCode.RGB, PixelCode.HSV),
                                                (PixelCode.ENCODING_BAYER_GRBG8, PixelCode.RGB), (-3, PixelCode.RGB),
                                                (PixelCode.RGB, PixelCode.YUV_420)])  # fmt: skip
def test_conversions_that_yarp_lacks_are_refused(source: int, target: int) -> None:
    with pytest.raises(ValueError, match="FlexImage"):
        convert(picture(source, 2, 2).numpy(), source, target)
    if target == PixelCode.RGB:
        image = picture(PixelCode.RGB, 4, 4)
        rgb = ImageRgb.from_bytes(image.to_bytes())
        with pytest.raises(WireError, match="FlexImage"):
            rgb.from_wire(picture(source, 2, 2).to_bytes())
        assert rgb == image


def test_all_pairs_are_converted_or_refused() -> None:
    for source in CODES:
        for target in CODES:
            try:
                converted = convert(picture(source, 2, 2).numpy(), source, target)
            except ValueError:
                continue
            form = format_of(target)
            assert converted.dtype == form.dtype
            assert converted.shape == ((2, 2) if len(form.channels) == 1 else (2, 2, len(form.channels)))


def test_rows_are_repadded_for_another_quantum() -> None:
    sent = picture(PixelCode.RGB, 3, 2, quantum=1)
    image = ImageRgb()
    image.resize(1, 1)
    image.from_wire(sent.to_bytes())
    assert (image.getQuantum(), image.getRowSize()) == (8, 16)
    assert np.array_equal(image.numpy(), sent.numpy())
    fresh = ImageRgb.from_bytes(sent.to_bytes())
    assert (fresh.getQuantum(), fresh.getRowSize()) == (1, 9)
    fresh.setQuantum(4)
    assert (fresh.getRowSize(), fresh == sent) == (12, True)


def test_copy_converts_and_scales() -> None:
    sent = picture(PixelCode.RGB, 4, 2)
    image = ImageBgr()
    assert image.copy(sent)
    assert np.array_equal(image.numpy()[..., ::-1], sent.numpy())
    small = ImageRgb()
    assert small.copy(sent, 2, 1)
    assert small.numpy().tolist() == sent.numpy()[:1, ::2].tolist()
    flexible = FlexImage()
    assert flexible.copy(sent)
    assert flexible.isEqual(sent)
    assert flexible.notEqual(image)
    flexible.resize(image)
    assert (flexible.width(), flexible.height()) == (4, 2)
    assert bytes(flexible.getRow(1)) == sent.numpy()[1].tobytes()
    flexible.fromstring(sent.tostring(), 4, 2)
    assert flexible == sent
    flexible.setPixelSize(3)
    assert (flexible.getPixelCode(), flexible.width()) == (PixelCode.RGB, 4)
    flexible.setPixelSize(5)
    assert (flexible.getPixelCode(), flexible.width()) == (-5, 0)


def test_vectors_memory_is_used_too() -> None:
    """YARP's test of its Python bindings does this."""
    vector, image = Vector(320 * 240), ImageMono()
    image.setExternal(vector, 320, 240)
    image.setPixel(1, 0, 255)
    assert (image.width(), image.height()) == (320, 240)
    assert vector.numpy().view("u1")[1] == 255

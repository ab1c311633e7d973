"""Images of all encodings, and invalid ones."""

from __future__ import annotations

import base64
import io
import struct
from typing import Any

import numpy as np
import pytest
from PIL import Image

from bridge.messages.errors import ConversionError
from bridge.web.feeds import pictures
from bridge.web.feeds.pictures import decode
from tests.peers.browser.page import TestPage
from tests.support.wait import until
from tests.web.conftest import Desk

RED = (200, 30, 10)


def message(encoding: str, cells: Any, *, padding: int = 0, big: bool = False) -> dict[str, Any]:
    array = np.asarray(cells)
    height, width = array.shape[:2]
    row = array.reshape(height, -1)
    padded = np.pad(row.view(np.uint8), ((0, 0), (0, padding)))
    if encoding in ("yuv422", "yuv422_yuy2", "uyvy", "yuyv"):
        width = row.shape[1] // 2
    return {
        "encoding": encoding, "width": width, "height": height, "step": padded.shape[1],
        "is_bigendian": int(big), "data": padded.reshape(-1),
    }  # fmt: skip


def solid(*channels: int, size: tuple[int, int] = (8, 6)) -> np.ndarray[Any, Any]:
    return np.full((*size, len(channels)), channels, np.uint8)


@pytest.mark.parametrize(
    ("encoding", "cells"),
    [
        ("rgb8", solid(*RED)),
        ("bgr8", solid(*RED[::-1])),
        ("8UC3", solid(*RED[::-1])),
        ("rgba8", solid(*RED, 255)),
        ("bgra8", solid(*RED[::-1], 255)),
        ("bayer_rggb8", np.tile(np.array([[200, 30], [30, 10]], np.uint8), (3, 4))),
        ("bayer_bggr8", np.tile(np.array([[10, 30], [30, 200]], np.uint8), (3, 4))),
        ("bayer_gbrg8", np.tile(np.array([[30, 10], [200, 30]], np.uint8), (3, 4))),
        ("bayer_grbg8", np.tile(np.array([[30, 200], [10, 30]], np.uint8), (3, 4))),
    ],
)
@pytest.mark.parametrize("padding", [0, 5])
def test_color_encodings_are_decoded(encoding: str, cells: np.ndarray[Any, Any], padding: int) -> None:
    picture_ = decode(message(encoding, cells, padding=padding), 320)
    assert picture_.image.size == (picture_.width, picture_.height) == cells.shape[1::-1]
    assert picture_.image.convert("RGB").getpixel((2, 2)) == RED
    assert picture_.range is None


@pytest.mark.parametrize(("encoding", "order"), [("yuv422", (1, 0, 3, 2)), ("yuyv", (0, 1, 2, 3))])
def test_yuv_encodings_are_decoded(encoding: str, order: tuple[int, ...]) -> None:
    y, u, v = Image.new("RGB", (1, 1), RED).convert("YCbCr").getpixel((0, 0))  # type: ignore[misc]
    four = np.empty(4, np.uint8)
    four[list(order)] = (y, u, y, v)
    picture_ = decode(message(encoding, np.tile(four, (6, 4)).reshape(6, 16, 1)), 320)
    assert (picture_.width, picture_.height) == (8, 6)
    assert picture_.image.size == (8, 6)
    assert picture_.image.getpixel((3, 3)) == pytest.approx(RED, abs=3)


@pytest.mark.parametrize(
    ("encoding", "kind"), [("16UC1", "<u2"), ("mono16", ">u2"), ("32FC1", "<f4"), ("32FC1", ">f4"), ("64FC1", "<f8")]
)
def test_measurements_are_scaled_from_smallest_to_largest(encoding: str, kind: str) -> None:
    cells = np.array([[0, 100], [200, 300]], kind)
    picture_ = decode(message(encoding, cells, big=kind[0] == ">"), 320)
    assert picture_.range == (100.0, 300.0)
    none, low, middle, high = picture_.image.tobytes()
    assert (none, low, high) == (0, 0, 255)
    assert middle in (127, 128)


def test_an_image_without_measurements_is_black() -> None:
    picture_ = decode(message("32FC1", np.full((2, 2), np.nan, np.float32)), 320)
    assert picture_.range == (0.0, 0.0)
    assert set(picture_.image.tobytes()) == {0}


@pytest.mark.parametrize("size", [(1000, 2000), (2000, 30), (3, 4000), (321, 320)])
@pytest.mark.parametrize("encoding", ["mono8", "16UC1", "bayer_rggb8"])
def test_large_images_are_scaled_down_proportionally(size: tuple[int, int], encoding: str) -> None:
    kind = np.uint16 if encoding == "16UC1" else np.uint8
    picture_ = decode(message(encoding, np.ones(size, kind)), 320)
    wide, high = picture_.image.size
    assert max(wide, high) == 320
    assert wide == max(1, round(size[1] * 320 / max(size)))
    assert high == max(1, round(size[0] * 320 / max(size)))


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_compressed_images_are_decoded_and_scaled(kind: str) -> None:
    out = io.BytesIO()
    Image.new("RGB", (800, 600), RED).save(out, kind)
    picture_ = decode({"format": f"rgb8; {kind.lower()}", "data": np.frombuffer(out.getvalue(), np.uint8)}, 160)
    assert (picture_.width, picture_.height, picture_.image.size) == (800, 600, (160, 120))
    assert picture_.image.getpixel((5, 5)) == pytest.approx(RED, abs=4)


def test_compressed_depth_images_are_decoded() -> None:
    out = io.BytesIO()
    Image.fromarray(np.array([[0, 1000], [2000, 3000]], np.uint16)).save(out, "PNG")
    data = struct.pack("<iff", 0, 0.0, 0.0) + out.getvalue()
    picture_ = decode({"format": "16UC1; compressedDepth png", "data": data}, 160)
    assert picture_.range == (1000.0, 3000.0)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"encoding": "cmyk"}, "encoded as 'cmyk' are not supported; supported: mono8"),
        ({"width": 0}, "0 x 6 pixels is not shown"),
        ({"width": 2**31, "height": 2**31}, "pixels is not shown: the limit"),
        ({"step": 10}, "a row has 10 bytes \\(step\\), but its pixels need 24"),
        ({"step": 2**31}, "144 bytes, but 6 rows of 2147483648 are needed"),
        ({"height": 7}, "144 bytes, but 7 rows of 24 are needed"),
        ({"data": np.zeros(0, np.uint8)}, "0 bytes, but 6 rows"),
        ({"encoding": "bayer_rggb8", "width": 1, "height": 1, "step": 1}, "no colors"),
    ],
)
def test_invalid_images_are_refused(change: dict[str, Any], why: str) -> None:
    good = message("rgb8", solid(*RED, size=(6, 8)))
    with pytest.raises(ConversionError, match=why):
        decode({**good, **change}, 320)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", b"GIF89a", b"\x89PNG\r\n\x1a\n" + bytes(50)])
def test_invalid_compressed_images_are_refused(data: bytes) -> None:
    with pytest.raises(ConversionError, match=r"cannot read the compressed image \(jpeg\)"):
        decode({"format": "jpeg", "data": data}, 320)


def test_a_huge_compressed_image_is_not_decompressed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "MOST_PIXELS", 100)
    out = io.BytesIO()
    Image.new("L", (50, 50)).save(out, "PNG")
    with pytest.raises(ConversionError, match="50 x 50 pixels is not shown"):
        decode({"format": "png", "data": out.getvalue()}, 320)


def test_an_image_on_the_hub_is_shown(desk: Desk) -> None:
    out = desk.far.advertise("/camera", "sensor_msgs/Image")
    cells = solid(*RED, size=(300, 400))
    image = message("rgb8", cells)
    with TestPage(desk.port) as page:
        page.watch("image:160:/camera")

        def publish() -> bool:
            desk.far.publish(out, {**image, "data": base64.b64encode(image["data"].tobytes()).decode()})
            page.read()
            return bool(page.values.get("image:160:/camera", {}).get("value"))

        until(publish, "the image is shown", every=0.05)
        picture_ = page.values["image:160:/camera"]["value"]
        assert (picture_["width"], picture_["height"], picture_["encoding"], picture_["range"]) == (
            400,
            300,
            "rgb8",
            None,
        )
        head, _, data = picture_["image"].partition(",")
        assert head == "data:image/jpeg;base64"
        shown = Image.open(io.BytesIO(base64.b64decode(data)))
        assert shown.size == (160, 120)
        assert shown.getpixel((80, 60)) == pytest.approx(RED, abs=4)


def test_other_types_are_refused_as_images(desk: Desk) -> None:
    out = desk.far.advertise("/words", "std_msgs/String")
    with TestPage(desk.port) as page:
        page.watch("image:160:/words", "image:161:/words", "image:160:words", "image:/words")
        page.until(lambda: len(page.errors()) == 3, "the invalid feeds are reported")
        assert "'image:161:/words' is not an image feed: use image:WIDTH:/NAME" in page.errors()[0]

        def publish() -> str:
            desk.far.publish(out, {"data": "x"})
            page.read()
            return str(page.values.get("image:160:/words", {}).get("why", ""))

        until(lambda: "std_msgs/msg/String is not an image type" in publish(), "the reason is reported", every=0.05)


def test_two_types_of_one_topic_are_distinguished(desk: Desk) -> None:
    strings, numbers = desk.far.advertise("/count", "std_msgs/String"), desk.far.advertise("/count", "std_msgs/Int32")
    first, other = "topic:/count@std_msgs/msg/String", "topic:/count@std_msgs/msg/Int32"
    with TestPage(desk.port) as page:
        page.watch("topic:/count", first, other, "topic:/count@std_msgs/msg/Bool")

        def publish() -> bool:
            desk.far.publish(strings, {"data": "yes"})
            desk.far.publish(numbers, {"data": 3})
            page.read()
            return all(page.values.get(feed, {}).get("value") for feed in (first, other))

        until(publish, "both messages are shown", every=0.05)
        assert page.values[first]["value"]["message"] == {"data": "yes"}
        assert page.values[other]["value"]["message"] == {"data": 3}
        reason = (
            "/count is published with several types: std_msgs/msg/Int32, std_msgs/msg/String; watch topic:/count@TYPE"
        )
        page.until(lambda: reason in page.values["topic:/count"].get("why", ""), "the types are reported")
        assert "no publisher of /count as std_msgs/msg/Bool" in page.values["topic:/count@std_msgs/msg/Bool"]["why"]

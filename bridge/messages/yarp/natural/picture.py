"""Pictures: `sensor_msgs/msg/Image` and ``yarp::sig::Image``; rows of YARP's are padded to a multiple of 8 bytes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.messages.errors import ConversionError
from bridge.messages.yarp.natural.kind import Kind, Message, Missing, header
from yarp_compat.sig.image import FlexImage
from yarp_compat.sig.pixels import PixelCode, format_of
from yarp_compat.sig.raster import QUANTUM
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer

_CODES = {
    "mono8": PixelCode.MONO,
    "8UC1": PixelCode.MONO,
    "mono16": PixelCode.MONO16,
    "16UC1": PixelCode.MONO16,
    "rgb8": PixelCode.RGB,
    "bgr8": PixelCode.BGR,
    "8UC3": PixelCode.BGR,
    "rgba8": PixelCode.RGBA,
    "bgra8": PixelCode.BGRA,
    "8UC4": PixelCode.BGRA,
    "8SC1": PixelCode.MONO_SIGNED,
    "8SC3": PixelCode.RGB_SIGNED,
    "32SC1": PixelCode.INT,
    "32SC3": PixelCode.RGB_INT,
    "32FC1": PixelCode.MONO_FLOAT,
    "32FC3": PixelCode.RGB_FLOAT,
    **{
        f"bayer_{code.name.rpartition('_')[2].rstrip('0123456789').lower()}{code.name[-2:].lstrip('BGR')}": code
        for code in PixelCode
        if "BAYER" in code.name
    },
}
"""ROS's encodings (``sensor_msgs/image_encodings.hpp``) and the pixels that hold the same."""

_ENCODINGS = {code: name for name, code in reversed(_CODES.items())}
"""Of several encodings, the first."""


class _Picture:
    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        code = _CODES.get(message["encoding"])
        if code is None:
            raise ConversionError(f"YARP has no pixels of the encoding {message['encoding']!r}")
        rows = _rows(message, format_of(code).size)
        if message["is_bigendian"] and format_of(code).dtype.itemsize > 1:
            rows = rows.view(format_of(code).dtype.newbyteorder(">")).astype(format_of(code).dtype).view(np.uint8)
        padding = -rows.shape[1] % QUANTUM
        if padding:
            rows = np.pad(rows, ((0, 0), (0, padding)))
        picture = FlexImage()
        picture.setPixelCode(code)
        picture.setQuantum(QUANTUM)
        picture.setExternal(np.ascontiguousarray(rows), message["width"], message["height"])
        picture.write(out)

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:
        picture = FlexImage()
        picture._read(source)
        name = _ENCODINGS.get(PixelCode(picture.getPixelCode())) if picture.getPixelCode() > 0 else None
        if name is None:
            raise ConversionError(f"ROS has no encoding for pixels of code {picture.getPixelCode()}")
        row = picture.width() * picture.getPixelSize()
        rows = np.frombuffer(picture.getRawImage(), np.uint8).reshape(picture.height(), picture.getRowSize())
        return {
            "header": header(stamp_ns, missing.frame or "camera"),
            "height": picture.height(),
            "width": picture.width(),
            "encoding": name,
            "is_bigendian": 0,
            "step": row,
            "data": rows[:, :row].reshape(-1),
        }


def _rows(message: Mapping[str, Any], pixel: int) -> np.ndarray:
    """The picture's rows, without what stands behind them."""
    width, height, step, data = (message[name] for name in ("width", "height", "step", "data"))
    if step < width * pixel or len(data) < step * height:
        raise ConversionError(
            f"{height} rows of {step} bytes for {width} pixels of {message['encoding']} do not fit {len(data)} bytes"
        )
    return np.asarray(data[: step * height]).reshape(height, step)[:, : width * pixel]


KINDS: Mapping[str, Kind] = {"sensor_msgs/msg/Image": _Picture()}

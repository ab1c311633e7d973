"""The feed ``image:WIDTH:/name``: the newest image of a topic, scaled down to the size at which the page shows it."""

from __future__ import annotations

import base64
import io
from typing import Any

from PIL import Image
from typing_extensions import override

from bridge.client.types import Types
from bridge.concurrency import SerialExecutor
from bridge.messages.errors import ConversionError
from bridge.messages.values import MessageReader
from bridge.modules.host import Host
from bridge.web.feeds.pictures import decode
from bridge.web.feeds.topics import NewestFeed

PREFIX = "image:"
WIDTHS = (160, 320, 640, 1280)
"""The allowed maximum widths and heights in pixels; these are few, so that pages share the scaled images."""

TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_QUALITY = 75


class ImageFeed(NewestFeed):
    """The newest image as a JPEG, scaled down. Raises `LookupError` if the name has no width of `WIDTHS`."""

    most_bytes = 64 << 20

    def __init__(self, host: Host, types: Types, executor: SerialExecutor, name: str) -> None:
        width, _, topic = name.removeprefix(PREFIX).partition(":")
        widths = [str(known) for known in WIDTHS]
        if width not in widths or not topic.startswith("/"):
            sizes = ", ".join(widths)
            raise LookupError(f"{name[:80]!r} is not an image feed: use image:WIDTH:/NAME, with WIDTH one of {sizes}")
        super().__init__(host, executor, name, topic)
        self._types, self._most = types, int(width)

    @override
    def value(self, type_name: str, type_hash: str, cdr: bytes) -> dict[str, Any]:
        """Return the image, and its original size and encoding."""
        if type_name not in TYPES:
            raise ConversionError(f"{type_name} is not an image type; image types are {' and '.join(TYPES)}")
        self._types.prepare(type_name, type_hash)
        registry = self._types.registry
        checked = registry.hub_check(type_name, type_hash)(cdr)
        message = MessageReader(registry.schema(type_name, type_hash), checked).message()
        picture = decode(message, self._most)
        about = {"frame": message["header"]["frame_id"], "encoding": picture.encoding, "range": picture.range}
        size = {"width": picture.width, "height": picture.height}
        return {**about, **size, "image": f"data:image/jpeg;base64,{base64.b64encode(_jpeg(picture.image)).decode()}"}


def _jpeg(image: Image.Image) -> bytes:
    out = io.BytesIO()
    image.save(out, "JPEG", quality=_QUALITY)
    return out.getvalue()

"""``/clock`` and YARP's network clock: a Bottle of two integers, seconds and nanoseconds.

Source: ``NetworkClock::read`` of YARP 3 and 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bridge.messages.errors import ConversionError
from bridge.messages.yarp.natural.kind import Kind, Message, Missing
from yarp_compat.wire.binary import decode_prefix, encode
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.text import to_text
from yarp_compat.wire.writer import Writer

CLOCK = "rosgraph_msgs/msg/Clock"


class _Clock:
    """Also taken in a list of its own, as YARP's converter of ROS messages would write it."""

    def to_yarp(self, message: Mapping[str, Any], out: Writer) -> None:
        time = message["clock"]
        out.block(encode([time["sec"], time["nanosec"]], out.profile))

    def to_ros(self, source: Reader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        values, source.at = decode_prefix(source.data, source.profile, source.at)
        if len(values) == 1 and isinstance(values[0], list):
            values = values[0]
        if len(values) != 2 or not all(type(value) is int for value in values) or not 0 <= values[1] < 1_000_000_000:
            raise ConversionError(f"a clock says two integers, seconds and nanoseconds: {to_text(values)[:80]}")
        return {"clock": {"sec": values[0], "nanosec": values[1]}}


KINDS: Mapping[str, Kind] = {CLOCK: _Clock()}

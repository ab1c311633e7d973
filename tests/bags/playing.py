"""ROS 1 bags for tests of playback, written by rosbags with fields that a test sets."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.rosbag1 import Writer

from tests.support.rosbags_messages import Messages

NS = 1_000_000_000
START = 1_700_000_000 * NS
ROS1 = Messages(ros1=True)


class Said(NamedTuple):
    """A message of a bag; times are in seconds from the beginning of the bag."""

    at: float
    topic: str
    type_name: str
    fields: dict[str, Any]


def write_bag(path: Path, messages: Iterable[Said], latched: Iterable[str] = ()) -> Path:
    """Write a ROS 1 bag of these messages; each topic has one publisher."""
    kept = set(latched)
    with Writer(path) as writer:
        connections: dict[str, Any] = {}
        for at, topic, type_name, fields in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, ROS1.full(type_name), typestore=ROS1.store, callerid="/robot", latching=int(topic in kept)
                )
            writer.write(connections[topic], START + round(at * NS), ROS1.encode(type_name, fields))
    return path


def stamp(at: float) -> dict[str, int]:
    """Return a time in the bag as a stamp, in rosbags' spelling."""
    seconds, nanoseconds = divmod(START + round(at * NS), NS)
    return {"sec": seconds, "nanosec": nanoseconds}


def transform(parent: str, child: str, at: float = 0.0, x: float = 0.0) -> dict[str, Any]:
    """Return one transform of a TFMessage."""
    return {
        "header": {"stamp": stamp(at), "frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": {"x": x}, "rotation": {"w": 1.0}},
    }

"""Bags as decoded by the stock readers: ROS 1's ``rosbag``, ``rosbags``, and ``mcap`` with ``mcap-ros2-support``."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from tests.peers.ros1.network import ROS1_PYTHON, ros1_environment
from tests.support.missing import ROS1, need

PROGRAM = Path(__file__).parents[1] / "peers" / "ros1" / "bag.py"

Message = tuple[str, str, Any]
"""Topic, type, and the message as the reader's object or as mappings."""
Ros1Message = tuple[str, str, str, Any]
"""Topic, type, full definition and values."""


def write_ros1(files: Mapping[Path, Sequence[Ros1Message]]) -> None:
    """Write bags with ``rosbag``."""
    _ros1("write", text=json.dumps({str(file): messages for file, messages in files.items()}))


def rosbag(files: Sequence[Path]) -> list[list[Message] | str]:
    """Read bags with ROS 1's ``rosbag``; return the messages of each file, or the error."""
    return [
        messages_
        if isinstance(messages_, str)
        else [(topic, type_name, value) for topic, type_name, value in messages_]
        for messages_ in json.loads(_ros1("read", *files))
    ]


def _ros1(*words: str | Path, text: str = "") -> str:
    need(ROS1)
    done = subprocess.run(
        [ROS1_PYTHON, PROGRAM, *words], input=text, env=ros1_environment(), capture_output=True, text=True, timeout=60,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def rosbags(file: Path) -> list[Message]:
    """Read a bag with ``rosbags``."""
    with AnyReader([file]) as bag:
        return [(c.topic, c.msgtype, bag.deserialize(raw, c.msgtype)) for c, _, raw in bag.messages()]


def mcap(file: Path) -> list[Message]:
    """Read a file with ``mcap`` and its ROS 2 decoder."""
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [(d.channel.topic, d.schema.name if d.schema else "", d.decoded_message)
                for d in reader.iter_decoded_messages()]  # fmt: skip


def _each(read: Callable[[Path], list[Message]]) -> Callable[[Sequence[Path]], list[list[Message] | str]]:
    def read_all(files: Sequence[Path]) -> list[list[Message] | str]:
        messages_: list[list[Message] | str] = []
        for file in files:
            try:
                messages_.append(read(file))
            except Exception as err:
                messages_.append(f"{type(err).__name__}: {err}")
        return messages_

    return read_all


READERS: dict[str, dict[str, Callable[[Sequence[Path]], list[list[Message] | str]]]] = {
    ".bag": {"rosbag": rosbag, "rosbags": _each(rosbags)},
    ".db3": {"rosbags": _each(rosbags)},
    ".mcap": {"rosbags": _each(rosbags), "mcap": _each(mcap)},
}
"""The readers of each format, which return the messages of each file, or the error."""


def member(message: Any, path: str) -> Any:
    """Return a member of a decoded message: ``feedback.distance_remaining``, ``request.0.data``."""
    for name in path.split("."):
        if name.isdigit():
            message = message[int(name)]
        elif isinstance(message, dict):
            message = message[name]
        else:
            message = getattr(message, name)
    return message

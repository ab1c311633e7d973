"""A hub participant that publishes for the recorder's tests, and a reader of the recorded files."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import EndOfFile
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader

from bridge.config.model import Config
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.record.places import RecordPlace
from bridge.record.section import RecordSection
from bridge.record.status import RecordingStatus
from bridge.record.worker import Recording
from tests.peers.hub.quick import QuickHub
from tests.support.wait import until

STRING = "std_msgs/msg/String"


class Robot:
    """A publisher of texts."""

    def __init__(self, hub: Hub) -> None:
        self.hub, self.registry = hub, Registry()

    def publisher(self, topic: str, qos: Qos | None = None, type_name: str = STRING) -> HubPublisher:
        return self.hub.publisher(topic, type_name, self.registry.ros2(type_name).type_id, qos or Qos())

    def text(self, text_: str) -> bytes:
        return from_json(self.registry, STRING, {"data": text_})

    def message(self, type_name: str, fields: dict[str, Any]) -> bytes:
        return from_json(self.registry, type_name, fields)


class FoundMessage(NamedTuple):
    topic: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class Contents(NamedTuple):
    """The content of a file; ``whole`` is whether the file has its end."""

    messages: list[FoundMessage]
    channels: dict[str, list[Channel]]
    metadata: dict[str, dict[str, str]]
    whole: bool

    def texts(self, topic: str) -> list[str]:
        return [text_of(message.data) for message in self.messages if message.topic == topic]


def text_of(data: bytes) -> str:
    return data[8 : 8 + int.from_bytes(data[4:8], "little") - 1].decode()


def read(path: Path) -> Contents:
    """Read a file's records in order, as far as possible, with the MCAP library."""
    contents = Contents([], {}, {}, whole=True)
    names: dict[int, str] = {}
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Channel) and record.id not in names:
                    names[record.id] = record.topic
                    contents.channels.setdefault(record.topic, []).append(record)
                elif isinstance(record, Message):
                    about = record.sequence, record.log_time, record.publish_time, record.data
                    contents.messages.append(FoundMessage(names[record.channel_id], *about))
                elif isinstance(record, Metadata):
                    contents.metadata[record.name] = record.metadata
        except (EndOfFile, struct.error):
            return contents._replace(whole=False)
    return contents


def config(hubs: QuickHub, state: Path, **section: Any) -> Config:
    return Config.model_validate({"name": "robot1", "state": str(state), "hub": hubs.config(), "record": section})


@contextmanager
def recording(hubs: QuickHub, state: Path, place: RecordPlace, **section: Any) -> Iterator[Recording]:
    """Run a recorder on a hub."""
    recorded = Recording("recorder", config(hubs, state, **section), RecordSection.model_validate(section), place)
    try:
        until(recorded.host.node.hub.linked, "the recorder has joined the hub")
        yield recorded
    finally:
        recorded.close()


def await_topics(recorded: Recording, count: int) -> None:
    until(lambda: len(recorded.recorder.topics.subscribed()) >= count, f"{count} topics are subscribed")


def await_written(recorded: Recording, count: int) -> RecordingStatus:
    def status() -> RecordingStatus | None:
        status = recorded.recorder.status()
        return status if status.messages >= count else None

    return until(status, f"{count} messages are written")

"""The files of a recording: when the next one begins."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

from bridge.client.topics import TopicKey
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.record.arrivals import RecordedMessage, TopicCounts
from bridge.record.places import Files
from bridge.record.section import RecordSection
from bridge.record.series import FileSeries
from tests.peers.hub.recorded_robot import STRING

CLOUD, CHAT = b"m" * 16, b"c" * 16


class Graph:
    """A latched publisher and one that is not."""

    def __init__(self) -> None:
        self.ends = {CLOUD: MagicMock(gid=CLOUD, qos=LATCHED), CHAT: MagicMock(gid=CHAT, qos=Qos())}
        self.endpoint = self.ends.get

    def zid_of(self, _gid: bytes) -> str:
        return "a"

    def publishers(self, topic: str = "") -> list[Any]:
        return [] if topic else list(self.ends.values())


def message(counts: TopicCounts, gid: bytes, data: bytes) -> RecordedMessage:
    now = time.time_ns()
    return RecordedMessage(counts, gid, None, 1, now, now, 0, data)


def test_latched_messages_above_the_split_size_do_not_begin_a_file_for_each_message(tmp_path: Path) -> None:
    section = RecordSection.model_validate({"split": {"size": 1}})
    definitions: Any = MagicMock()
    definitions.find.return_value = "string data\n"
    graph: Any = Graph()
    series = FileSeries(Files(tmp_path / "run", split=True), section, {}, graph, definitions)
    cloud, chat = (TopicCounts(name, TopicKey(name, STRING, "")) for name in ("/cloud", "/chat"))
    series.write(message(cloud, CLOUD, os.urandom(3 << 20)))
    for _ in range(20):
        series.write(message(chat, CHAT, b"small"))
    assert series.count == 2, "the file of the first cloud is full, and the next one begins with the cloud"
    for _ in range(3):
        series.write(message(chat, CHAT, os.urandom(600_000)))
    series.close()
    assert series.count == 4

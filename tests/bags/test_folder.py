"""Rosbag2 folders with files that overlap in time or cannot be opened, or with many files."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import pytest

from bridge.bags.bag import Bag, BagError, BagMessage, BagTopic
from bridge.bags.copy import convert, cut
from bridge.bags.folder import FolderBag
from bridge.bags.reader import open_bag
from bridge.messages.definitions.schema import World
from bridge.messages.registry import Registry
from tests.bags.written import SECOND, START, STRING, db3_folder, mcap_file

EMPTY, GARBAGE = b"", b"\0" * 300
FILES = 20


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with three files that have the same 21 messages."""
    bag_ = tmp_path / "run"
    bag_.mkdir()
    for number in range(3):
        mcap_file(bag_ / f"run_{number}.mcap")
    return bag_


def test_files_that_overlap_are_read_in_order_of_time(folder: Path) -> None:
    with open_bag(folder) as bag:
        assert [topic.count for topic in bag.topics] == [3, 60]
        times = [message.time_ns for message in bag.messages()]
        assert (len(times), times) == (63, sorted(times))
        start = START + SECOND
        assert [m.time_ns for m in bag.messages(None, start, start + 2)] == [start] * 3


class CountingBag(Bag):
    """A file with one message per second; ``reading`` counts the files that are being read."""

    reading = most = 0

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        number = int(path.stem)
        self.kind = "mcap"
        self.topics = (BagTopic("/a", STRING, World.ROS2, count=3),)
        self.start_ns, self.end_ns = 2 * number * SECOND, (2 * number + 2) * SECOND

    def messages(
        self, topics: Collection[BagTopic] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        assert (topics, start_ns, end_ns) == (None, None, None)
        CountingBag.reading += 1
        CountingBag.most = max(CountingBag.most, CountingBag.reading)
        for time in range(self.start_ns, self.end_ns + 1, SECOND):
            yield BagMessage(self.topics[0], time, time, b"")
        CountingBag.reading -= 1

    def close(self) -> None:
        """Do nothing, because nothing is open."""


def test_only_files_of_the_current_time_are_read(tmp_path: Path) -> None:
    for number in range(FILES):
        (tmp_path / f"{number:02}.mcap").touch()
    with FolderBag(tmp_path, CountingBag) as bag:
        times = [message.time_ns for message in bag.messages()]
    assert (times, len(times)) == (sorted(times), 3 * FILES)
    assert (CountingBag.reading, CountingBag.most) == (0, 2)


@pytest.mark.parametrize(("content", "words"), [(EMPTY, "is empty"), (GARBAGE, "is neither an MCAP file")])
def test_a_file_that_cannot_be_opened_loses_only_its_messages(
    content: bytes, words: str, folder: Path, tmp_path: Path
) -> None:
    (folder / "run_1.mcap").write_bytes(content)
    with open_bag(folder) as bag:
        assert "run_1.mcap" in str(bag.trouble)
        assert words in str(bag.trouble)
        messages_: list[BagMessage] = []
        with pytest.raises(BagError, match=r"run_1\.mcap"):  # raised after all messages of the other files
            messages_.extend(bag.messages())
        assert len(messages_) == 42
        for refused in (
            lambda: convert(bag, tmp_path / "a.bag", "bag", Registry()), lambda: cut(bag, tmp_path / "a.mcap")
        ):  # fmt: skip
            with pytest.raises(BagError, match=rf"run_1\.mcap.*{words}.*midspan bag mend"):
                refused()
        done = cut(bag, tmp_path / "whole.mcap", mend=True)
    assert (done.messages, [err.path.name for err in done.damage]) == (42, ["run_1.mcap"])
    with open_bag(tmp_path / "whole.mcap") as whole:
        assert (whole.trouble, sum(1 for _ in whole.messages())) == (None, 42)


def test_all_files_that_cannot_be_opened_are_reported(folder: Path, tmp_path: Path) -> None:
    for number in (0, 2):
        (folder / f"run_{number}.mcap").write_bytes(GARBAGE)
    with open_bag(folder) as bag:
        assert "run_0.mcap" in str(bag.trouble)
        assert [name.split()[0] for name in bag.left_out] == ["run_2.mcap"]
        assert [err.path.name for err in cut(bag, tmp_path / "a.mcap", mend=True).damage] == [
            "run_0.mcap",
            "run_2.mcap",
        ]
    (folder / "run_1.mcap").write_bytes(EMPTY)
    with pytest.raises(BagError, match=r"run_2\.mcap, byte 0"):
        open_bag(folder)


def test_without_its_metadata_a_folder_is_mended(tmp_path: Path) -> None:
    folder = db3_folder(tmp_path / "run")
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    with open_bag(folder) as bag:
        with pytest.raises(BagError, match=r"metadata\.yaml.*midspan bag mend"):
            cut(bag, tmp_path / "a.db3")
        done = cut(bag, tmp_path / "a.db3", mend=True)
    assert (done.messages, [err.path.name for err in done.damage]) == (21, ["metadata.yaml"])

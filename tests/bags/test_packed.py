"""Bags that rosbag2 compressed, without their folder and metadata."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
import zstandard

from bridge.bags.bag import BagError
from bridge.bags.copy import convert, cut
from bridge.bags.reader import open_bag
from bridge.messages.registry import Registry
from tests.bags.foreign import CDR, Recorded, foreign_mcap, humble_db3
from tests.bags.stock import rosbags
from tests.bags.written import STRING, db3_folder, mcap_file, ros1_bag

TEXTS = ["m0", "m1", "m2"]
PLAIN = [CDR + b"\3\0\0\0" + text.encode() + b"\0" for text in TEXTS]
PACKED = [zstandard.compress(data) for data in PLAIN]


def alone(folder: Path, ending: str, messages: list[bytes]) -> Path:
    """Write a single file of a format, with these messages, which may be compressed."""
    if ending == ".db3":
        return humble_db3(folder / "a.db3", Recorded("/text", STRING, None, messages))
    return foreign_mcap(folder / "a.mcap", Recorded("/text", STRING, "string data\n", messages))


@pytest.mark.parametrize("ending", [".db3", ".mcap"])
@pytest.mark.parametrize("messages", [PACKED, [PLAIN[0], *PACKED[1:]]], ids=["all", "some"])
def test_compressed_messages_are_read_without_metadata(ending: str, messages: list[bytes], tmp_path: Path) -> None:
    with open_bag(alone(tmp_path, ending, messages)) as bag:
        assert [message.data for message in bag.messages()] == PLAIN
        assert bag.compression == ("zstd" if messages is PACKED or ending == ".mcap" else "none")
        for target in ("a.bag", "b.mcap", "folder"):
            kind = "db3" if target == "folder" else "bag" if target == "a.bag" else "mcap"
            convert(bag, tmp_path / target, kind, Registry())
            assert [message.data for *_, message in rosbags(tmp_path / target)] == TEXTS


def test_a_damaged_compressed_message_is_an_error(tmp_path: Path) -> None:
    broken = [PACKED[0], PACKED[1][:9] + b"\xff\xff", PACKED[2]]
    with open_bag(alone(tmp_path, ".db3", broken)) as bag, pytest.raises(BagError, match=r"a\.db3: is damaged"):
        list(bag.messages())


def test_a_message_of_ros1_may_start_like_zstd(tmp_path: Path) -> None:
    recorded = Recorded("/number", "std_msgs/UInt32", "uint32 data\n", [PACKED[0][:4]])
    with open_bag(foreign_mcap(tmp_path / "a.mcap", recorded, encoding="ros1")) as bag:
        assert [message.data for message in bag.messages()] == [PACKED[0][:4]]


@pytest.mark.parametrize("form", ["db3", "mcap", "bag"])
@pytest.mark.parametrize("name", ["run.zstd", "run.db3.zst", "run"])
def test_a_single_compressed_file_is_read(form: str, name: str, tmp_path: Path) -> None:
    if form == "db3":
        plain = next(db3_folder(tmp_path / "run").glob("*.db3"))
    else:
        plain = mcap_file(tmp_path / "a.mcap") if form == "mcap" else ros1_bag(tmp_path / "a.bag")
    source = tmp_path / "packed" / name
    source.parent.mkdir()
    source.write_bytes(zstandard.compress(plain.read_bytes()))
    with open_bag(plain) as expected, open_bag(source) as bag:
        assert (bag.kind, bag.compression, bag.size) == (form, "zstd", source.stat().st_size)
        assert (bag.unfinished, bag.trouble, bag.path) == (False, None, source)
        assert [message.data for message in bag.messages()] == [message.data for message in expected.messages()]
        done = cut(bag, tmp_path / f"cut.{form}")
    assert done.messages == 21
    with open_bag(tmp_path / f"cut.{form}") as whole:
        assert sum(topic.count for topic in whole.topics) == 21


def test_errors_name_the_compressed_file(tmp_path: Path) -> None:
    source = tmp_path / "run.mcap.zstd"
    source.write_bytes(zstandard.compress(mcap_file(tmp_path / "a.mcap").read_bytes()[:-40]))
    with open_bag(source) as bag:
        assert bag.unfinished
        assert str(bag.trouble).startswith(f"{source}, byte")
    source.write_bytes(zstandard.compress(b"no bag"))
    with pytest.raises(BagError, match=rf"{source}, byte 0: is neither an MCAP file"):
        open_bag(source)
    source.write_bytes(zstandard.compress(bytes(1000))[:-5])
    with pytest.raises(BagError, match=str(source)):
        open_bag(source)


def test_other_archives_are_refused_with_the_cure(tmp_path: Path) -> None:
    source = tmp_path / "run.bag.gz"
    source.write_bytes(gzip.compress(ros1_bag(tmp_path / "a.bag").read_bytes()))
    with pytest.raises(BagError, match="unpack it with 'gunzip' first"):
        open_bag(source)


def test_a_folder_with_another_message_compression_is_refused(tmp_path: Path) -> None:
    folder = db3_folder(tmp_path / "run")
    metadata = folder / "metadata.yaml"
    text = metadata.read_text().replace("compression_mode: ''", "compression_mode: MESSAGE")
    metadata.write_text(text.replace("compression_format: ''", "compression_format: lz4"))
    with pytest.raises(BagError, match=r"its messages are compressed with 'lz4'"):
        open_bag(folder)

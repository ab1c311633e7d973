"""Writes ``metadata.yaml`` into a folder of recordings, as rosbag2 does.

The format has version 9 (rosbag2_storage, metadata_io.cpp and topic_metadata.hpp; in Jazzy and later).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bridge.bags.mcap_writer import ChannelInfo
from bridge.bags.qos import qos_yaml
from bridge.record.file import WrittenFile

VERSION = 9


def write_metadata(folder: Path, files: Sequence[WrittenFile]) -> None:
    """Replace the file, either completely or not at all; raises `OSError`."""
    import yaml  # recordings of single files do not need it

    temporary = folder / ".metadata.yaml"
    temporary.write_text(yaml.safe_dump(metadata(files), sort_keys=False), encoding="utf-8")
    temporary.replace(folder / "metadata.yaml")


def metadata(files: Sequence[WrittenFile]) -> dict[str, Any]:
    """Return the metadata of one or several files."""
    channels: dict[tuple[str, str], list[tuple[ChannelInfo, int]]] = {}
    for file in files:
        for info, messages in file.topics:
            channels.setdefault((info.topic, info.type_name), []).append((info, messages))
    begin, end = min(file.begin for file in files), max(file.end for file in files)
    return {
        "rosbag2_bagfile_information": {
            "version": VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": end - begin},
            "starting_time": {"nanoseconds_since_epoch": begin},
            "message_count": sum(file.messages for file in files),
            "topics_with_message_count": list(map(_topic, channels.values())),
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file.path.name for file in files],
            "files": [_file(file) for file in files],
            "custom_data": None,
            "ros_distro": "jazzy",
        }
    }


def _topic(channels: Sequence[tuple[ChannelInfo, int]]) -> dict[str, Any]:
    """Return a topic's entry, given its channels, one for each origin and file."""
    import yaml

    info, offered = channels[0][0], tuple(dict.fromkeys(qos for channel, _ in channels for qos in channel.qos))
    about = {
        "name": info.topic,
        "type": info.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": yaml.safe_load(qos_yaml(offered)) or [],
        "type_description_hash": info.type_hash,
    }
    return {"topic_metadata": about, "message_count": sum(messages for _, messages in channels)}


def _file(file: WrittenFile) -> dict[str, Any]:
    return {
        "path": file.path.name,
        "starting_time": {"nanoseconds_since_epoch": file.begin},
        "duration": {"nanoseconds": file.end - file.begin},
        "message_count": file.messages,
    }

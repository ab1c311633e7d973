"""Writes the hub's CDR unchanged to MCAP, in the form that ROS 2's tools and Foxglove read.

Facts from the format (https://mcap.dev/spec, https://mcap.dev/spec/registry): profile ``ros2``, message encoding
``cdr``, schema encoding ``ros2msg`` or ``ros2idl`` with the full definition (`bridge.bags.definitions`). The channel
metadata ``offered_qos_profiles`` and ``topic_type_hash`` are those of rosbag2's storage plugin (rosbag2_storage_mcap,
mcap_storage.cpp), as is the empty schema of a type without a known definition; Midspan adds ``side`` and ``origin``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import BinaryIO, Literal

from mcap.writer import CompressionType, Writer

from bridge import __version__
from bridge.bags.definitions import MSG, stored_definition
from bridge.bags.qos import qos_yaml
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Qos

Compression = Literal["zstd", "lz4", "none"]

PROFILE = "ros2"
CHUNK_BYTES = 1 << 20
"""Uncompressed size in bytes above which a chunk is closed; a larger message fills a separate chunk."""

_COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
_UNBOUNDED = 1 << 62
_RECORD = 31
"""Bytes of a message record without its data: opcode, length, channel, sequence and two times."""


@dataclass(frozen=True)
class ChannelInfo:
    """One channel: a topic with a type, from one origin.

    Attributes:
        type_name: as ROS 2 spells it, ``std_msgs/msg/String``.
        type_hash: ``RIHS01_...``, "" if unknown.
        definition: the full definition as ``.msg`` text; None if unknown.
        qos: the offered profile of each publisher.
        side: the side that it comes from: ``ros1``, ``ros2``, ``yarp``, ``zenoh``; "" if unknown.
        origin: the foreign network that it comes from, None for a native participant of the hub.
        more: further metadata.
    """

    topic: str
    type_name: str
    type_hash: str = ""
    definition: str | None = None
    qos: tuple[Qos, ...] = ()
    side: str = ""
    origin: Origin | None = None
    more: dict[str, str] = field(default_factory=dict)

    def metadata(self) -> dict[str, str]:
        """Return the channel's metadata."""
        values = {"offered_qos_profiles": qos_yaml(self.qos), "topic_type_hash": self.type_hash}
        if self.side:
            values["side"] = self.side
        if self.origin is not None:
            values |= {"origin": self.origin.network, "daemon": self.origin.daemon}
        return values | self.more


class McapWriter:
    """Writes one MCAP file to a stream, which stays open. Not safe to use from several threads.

    Args:
        stream: its ``write`` must accept all bytes at once.
        compression: the compression of the chunks.
        chunk_bytes: see `CHUNK_BYTES`.

    Attributes:
        pending: uncompressed bytes of the open chunk, which are not written yet.
        messages: number of messages passed to `write`.
    """

    def __init__(self, stream: BinaryIO, compression: Compression = "zstd", chunk_bytes: int = CHUNK_BYTES) -> None:
        # the library must not close a chunk by itself, so that this class knows what is written
        self._writer = Writer(stream, _UNBOUNDED, _COMPRESSIONS[compression])
        self._chunk_bytes = chunk_bytes
        self._schemas: dict[tuple[str, str], int] = {}
        self.pending = self.messages = 0
        self._writer.start(PROFILE, f"midspan {__version__}")

    def channel(self, info: ChannelInfo) -> int:
        """Add a channel and return its number for `write`. A file has at most 65,535 channels."""
        encoding, text = stored_definition(info.type_name, info.definition or "")
        if info.definition == "":
            encoding = MSG
        schema = self._schemas.get((info.type_name, text))
        if schema is None:
            schema = self._writer.register_schema(info.type_name, encoding, text.encode())
            self._schemas[info.type_name, text] = schema
        self.pending += len(text)
        return self._writer.register_channel(info.topic, "cdr", schema, info.metadata())

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a metadata record outside of the chunks."""
        self._writer.add_metadata(name, values)

    def write(self, channel: int, log_time: int, publish_time: int, data: bytes, sequence: int = 0) -> bool:
        """Add a message: CDR with its header, times in nanoseconds since 1970. Raises the `OSError` of the stream.

        Returns:
            Whether this closed the chunk, so that all messages so far are written.
        """
        self._writer.add_message(channel, log_time, data, publish_time, sequence & 0xFFFFFFFF)
        self.messages += 1
        self.pending += _RECORD + len(data)
        closed = self.pending > self._chunk_bytes
        if closed:
            self.flush()
        return closed

    def closes(self, size: int) -> bool:
        """Return whether a message of ``size`` bytes would close the chunk."""
        return self.pending + _RECORD + size > self._chunk_bytes

    def flush(self) -> None:
        """Close the chunk; then all messages are on the stream, and readable even if nothing follows."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self.pending = 0

    def finish(self) -> None:
        """Write the summary, which is the index for readers; nothing can be added afterwards."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._writer.flush()  # type: ignore[no-untyped-call]  # flushes the stream; the last chunk is closed
        self.pending = 0

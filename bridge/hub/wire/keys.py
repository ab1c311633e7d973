"""Names on the hub, the zenoh keys that contain them, and the attachment of each sample.

A topic's key is ``<domain>/<topic without outer slashes>/<DDS type name>/<RIHS01 hash>``. In liveliness tokens a name
is one chunk of the key, with ``%`` for its slashes (rmw_zenoh, docs/design.md). Humble's types have no hash, so its
rmw_zenoh writes ``TypeHashNotSupported`` in tokens and keys (rmw_zenoh_cpp 0.1.9, rmw_publisher_data.cpp).

The attachment has 33 bytes since Jazzy's 0.2.4: the sequence number and the source time (int64, little endian), then
the GID as an array in zenoh's serialization: its length (16) in one byte, then the bytes (rmw_zenoh_cpp,
attachment_helpers.cpp).
"""

from __future__ import annotations

import re
import struct

from bridge.hub.errors import HubWireError

ANY_HASH = "*"
"""In place of a type hash: any hash that the publisher has."""

NO_HASH = ""
"""In place of a type hash: the endpoint's release has no hashes (Humble)."""

_NO_HASH_CHUNK = "TypeHashNotSupported"

_TOPIC = re.compile(r"/[^\s/*$?#%@][^\s/*$?#%]*(?:/[^\s/*$?#%@][^\s/*$?#%]*)*")
_TYPE = re.compile(r"([A-Za-z]\w*)/(msg|srv|action)/([A-Za-z]\w*)", re.ASCII)
_DDS_TYPE = re.compile(r"([A-Za-z]\w*)::(msg|srv|action)::dds_::([A-Za-z]\w*?)_", re.ASCII)
_HASH = re.compile(r"RIHS[0-9]{2}_[0-9a-f]{1,128}")
_MAX_NAME = 1024


def check_topic(topic: str) -> str:
    """Return the topic name if it is absolute and can be part of a zenoh key, else raise `HubWireError`."""
    if len(topic) > _MAX_NAME or not _TOPIC.fullmatch(topic):
        raise HubWireError(
            f"topic name {topic[:80]!r} must be absolute, without empty parts, blanks or any of * $ ? # %"
        )
    return topic


def dds_type_name(type_name: str) -> str:
    """Convert ``std_msgs/msg/String`` to ``std_msgs::msg::dds_::String_``; raises `HubWireError`."""
    match = _TYPE.fullmatch(type_name)
    if match is None:
        raise HubWireError(f"type name {type_name[:80]!r} is not of the form package/msg/Name")
    return "{}::{}::dds_::{}_".format(*match.groups())


def ros_type_name(dds_name: str) -> str:
    """Convert ``std_msgs::msg::dds_::String_`` to ``std_msgs/msg/String``; raises `HubWireError`."""
    match = _DDS_TYPE.fullmatch(dds_name)
    if match is None:
        raise HubWireError(f"type {dds_name[:80]!r} is not of the form package::msg::dds_::Name_")
    return "{}/{}/{}".format(*match.groups())


def check_hash(type_hash: str) -> str:
    """Return a type hash if it has ROS 2's form (``RIHS01_`` and hex digits), else raise `HubWireError`."""
    if not _HASH.fullmatch(type_hash):
        raise HubWireError(f"type hash {type_hash[:80]!r} is not of the form RIHS01_<hex digits>")
    return type_hash


def has_key(type_hash: str) -> bool:
    """Return whether endpoints with this hash, or `NO_HASH`, have a key; tokens may contain any text."""
    return type_hash == NO_HASH or _HASH.fullmatch(type_hash) is not None


def hash_chunk(type_hash: str) -> str:
    """Return a type hash, or `NO_HASH`, as a chunk of a key; raises `HubWireError`."""
    return _NO_HASH_CHUNK if type_hash == NO_HASH else check_hash(type_hash)


def parse_hash_chunk(chunk: str) -> str:
    """Return the hash in a chunk of a token, or `NO_HASH`; the hash is not checked."""
    return NO_HASH if chunk == _NO_HASH_CHUNK else chunk


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """Return the key on which a publisher's samples are sent; the hash may be `NO_HASH`."""
    return f"{domain}/{check_topic(topic)[1:]}/{dds_type_name(type_name)}/{hash_chunk(type_hash)}"


def key_variant(key: str, type_hash: str) -> str:
    """Return the key of the same topic or service with another hash, which may be `NO_HASH`."""
    return f"{key.rpartition('/')[0]}/{hash_chunk(type_hash)}"


def key_type(key: str) -> tuple[str, str]:
    """Return the type and the hash in the key of a topic or service; the hash may be `NO_HASH` or `ANY_HASH`."""
    *_, dds_name, chunk = key.split("/")
    return ros_type_name(dds_name), parse_hash_chunk(chunk)


def subscription_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """Return the key of a subscription; the hash may be `ANY_HASH` or `NO_HASH`."""
    if type_hash != ANY_HASH:
        return topic_key(domain, topic, type_name, type_hash)
    return f"{domain}/{check_topic(topic)[1:]}/{dds_type_name(type_name)}/*"


def mangle(name: str) -> str:
    """Return a name as one chunk of a key: ``/`` and the empty name become ``%``."""
    return name.replace("/", "%") if name else "%"


def demangle(chunk: str) -> str:
    """Return the name in a chunk of a token."""
    return chunk.replace("%", "/")


GID_SIZE = 16
ATTACHMENT = struct.Struct(f"<qqB{GID_SIZE}s")
ATTACHMENT_SIZE = ATTACHMENT.size


def pack_attachment(sequence: int, source_time_ns: int, gid: bytes) -> bytes:
    """Return the bytes of a sample's attachment."""
    return ATTACHMENT.pack(sequence, source_time_ns, GID_SIZE, gid)


def unpack_attachment(data: bytes) -> tuple[int, int, bytes]:
    """Parse an attachment; raises `HubWireError` if it does not have rmw_zenoh's format.

    Returns:
        The sample's number (per publisher, starting at 1), its source timestamp (system time in nanoseconds since
        1970), and the 16-byte GID of its publisher.
    """
    if len(data) != ATTACHMENT_SIZE:
        raise HubWireError(
            f"attachment of {len(data)} bytes instead of {ATTACHMENT_SIZE}: rmw_zenoh before 0.2.4 uses another format"
        )
    sequence, time_ns, size, gid = ATTACHMENT.unpack(data)
    if size != GID_SIZE:
        raise HubWireError(f"attachment with a GID of {size} bytes instead of {GID_SIZE}")
    return sequence, time_ns, gid

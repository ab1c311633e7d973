"""Names on the hub and the zenoh keys that carry them.

A topic's key is ``<domain>/<topic without outer slashes>/<DDS type name>/<RIHS01 hash>``; in liveliness tokens a name
is one chunk of the key, so that its slashes become ``%`` (rmw_zenoh, docs/design.md).
"""

from __future__ import annotations

import re

from bridge.hub.errors import WireError

ANY_HASH = "*"
"""In place of a type hash: whatever hash the publisher has."""

_TOPIC = re.compile(r"/[^\s/*$?#%@][^\s/*$?#%]*(?:/[^\s/*$?#%@][^\s/*$?#%]*)*")
_TYPE = re.compile(r"([A-Za-z]\w*)/(msg|srv|action)/([A-Za-z]\w*)", re.ASCII)
_DDS_TYPE = re.compile(r"([A-Za-z]\w*)::(msg|srv|action)::dds_::([A-Za-z]\w*?)_", re.ASCII)
_HASH = re.compile(r"RIHS[0-9]{2}_[0-9a-f]{1,128}")
_MAX_NAME = 1024


def check_topic(topic: str) -> str:
    """Return an absolute topic name that can be a part of a zenoh key, or raise `WireError`."""
    if len(topic) > _MAX_NAME or not _TOPIC.fullmatch(topic):
        msg = f"topic name {topic[:80]!r} must be absolute, without empty parts, blanks and any of * $ ? # %"
        raise WireError(msg)
    return topic


def dds_type_name(type_name: str) -> str:
    """``std_msgs/msg/String`` -> ``std_msgs::msg::dds_::String_``."""
    match = _TYPE.fullmatch(type_name)
    if match is None:
        msg = f"type name {type_name[:80]!r} is not of the form package/msg/Name"
        raise WireError(msg)
    return "{}::{}::dds_::{}_".format(*match.groups())


def ros_type_name(dds_name: str) -> str:
    """``std_msgs::msg::dds_::String_`` -> ``std_msgs/msg/String``."""
    match = _DDS_TYPE.fullmatch(dds_name)
    if match is None:
        msg = f"type {dds_name[:80]!r} is not of the form package::msg::dds_::Name_"
        raise WireError(msg)
    return "{}/{}/{}".format(*match.groups())


def check_hash(type_hash: str) -> str:
    """Return a type hash as ROS 2 writes it (``RIHS01_`` and 64 hex digits), or raise `WireError`."""
    if not _HASH.fullmatch(type_hash):
        msg = f"type hash {type_hash[:80]!r} is not of the form RIHS01_<hex digits>"
        raise WireError(msg)
    return type_hash


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """The key that a publisher's samples travel on."""
    return f"{domain}/{check_topic(topic)[1:]}/{dds_type_name(type_name)}/{check_hash(type_hash)}"


def subscription_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """The key that a subscription hears; the hash may be `ANY_HASH`."""
    if type_hash != ANY_HASH:
        return topic_key(domain, topic, type_name, type_hash)
    return f"{domain}/{check_topic(topic)[1:]}/{dds_type_name(type_name)}/*"


def mangle(name: str) -> str:
    """A name as one chunk of a key: ``/`` becomes ``%``, and so does the empty name."""
    return name.replace("/", "%") if name else "%"


def demangle(chunk: str) -> str:
    """The name that a chunk of a token stands for."""
    return chunk.replace("%", "/")

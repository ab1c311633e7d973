"""What a bag stores of a message type: a definition and a fingerprint, each of which may be missing."""

from __future__ import annotations

import re
from functools import lru_cache

from bridge.bags.definitions import MSG, full_definition
from bridge.messages.definitions.hashes import EMPTY_MD5, rihs01
from bridge.messages.definitions.schema import Definition, Schema, World

EMPTY = "\n"
"""The text of a definition without fields, as `bridge.messages.definitions.text.full_text` writes it.

An empty text means that there is no definition.
"""

_HASH = re.compile(r"RIHS01_(?!0{64})[0-9a-f]{64}")
_CACHED = 500


def stored_hash(text: str) -> str:
    """Return a ROS 2 type hash; "" for zeros and for rosidl's ``INVALID``, which writers store for an unknown hash."""
    return text if _HASH.fullmatch(text) else ""


def ros1_definition(text: str, md5: str) -> str:
    """Return the definition of a ROS 1 type, "" if the bag has none. A type without fields is known by its md5."""
    return text or (EMPTY if md5 == EMPTY_MD5 else "")


@lru_cache(maxsize=_CACHED)
def ros2_definition(type_name: str, encoding: str, text: str, type_hash: str) -> str:
    """Return the full definition of a ROS 2 type, "" if the bag has none that can be parsed.

    An empty text means an empty message if the bag stores no hash, or the hash of an empty message. For unknown types
    rosbag2 stores a special encoding, but rosbags stores an empty text.
    """
    if text or encoding != MSG:
        return full_definition(type_name, encoding, text)
    empty = Definition(type_name, World.ROS2, ())
    return EMPTY if type_hash in ("", rihs01(Schema(empty, {type_name: empty}))) else ""

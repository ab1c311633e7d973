"""Type support created from name and hash."""

from __future__ import annotations

import pytest

from bridge.adapters.ros2.types import TypeSupports
from bridge.messages.errors import MessageTypeError

HASH = "RIHS01_" + "0a" * 32


def test_each_name_and_hash_has_one_class() -> None:
    types = TypeSupports()
    first = types.message_class("a_msgs/msg/B", HASH)
    assert types.message_class("a_msgs/msg/B", HASH) is first
    assert types.message_class("a_msgs/msg/B", "RIHS01_" + "0b" * 32) is not first


@pytest.mark.parametrize(
    ("name", "hash_"),
    [
        ("a_msgs/B", HASH),
        ("a_msgs/msg/B; drop", HASH),
        ("a_msgs/msg/B", ""),
        ("a_msgs/msg/B", "RIHS01_xyz"),
        ("", HASH),
    ],
)
def test_invalid_types_are_refused(name: str, hash_: str) -> None:
    with pytest.raises(MessageTypeError):
        TypeSupports().message_class(name, hash_)

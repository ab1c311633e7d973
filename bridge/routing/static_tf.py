"""Merging of static transforms: each publisher tells its own, every late joiner must get them all.

ROS 1 latches one message per publisher and tf2's Python broadcaster keeps none of its earlier ones, so the set is kept
here, by child frame, and given whole as one message. Such a topic is known by its type and by being latched.
"""

from __future__ import annotations

from typing import Any

from rosbags.typesys import Stores, get_typestore

TF_TYPE = "tf2_msgs/msg/TFMessage"
MAX_FRAMES = 100_000


class StaticTransforms:
    """The static transforms of one topic, by child frame; the newest word on a frame wins."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._by_child: dict[str, Any] = {}

    def __len__(self) -> int:
        return len(self._by_child)

    def merge(self, cdr: bytes) -> bytes:
        """Take up one TFMessage (CDR) and return the whole set as one.

        Raises:
            ValueError: the bytes are not a TFMessage, or there are more than `MAX_FRAMES` frames.
        """
        try:
            message = self._store.deserialize_cdr(cdr, TF_TYPE)
        except Exception as err:
            msg = f"not a {TF_TYPE}: {err}"
            raise ValueError(msg) from err
        for transform in message.transforms:  # type: ignore[attr-defined]
            self._by_child[transform.child_frame_id] = transform
        if len(self._by_child) > MAX_FRAMES:
            msg = f"more than {MAX_FRAMES} static frames"
            raise ValueError(msg)
        message.transforms = list(self._by_child.values())  # type: ignore[attr-defined]
        return bytes(self._store.serialize_cdr(message, TF_TYPE))

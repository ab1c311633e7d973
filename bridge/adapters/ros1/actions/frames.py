"""Checks the frames of goals against the side's transforms, because a goal in an unknown frame may never end.

move_base leaves such a goal ACTIVE forever, and also a goal whose frame begins with a slash, which tf2 does not allow.
"""

from __future__ import annotations

import contextlib
import logging
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from bridge.adapters.ros1.actions.network import ActionNetwork, TopicSubscription
from bridge.adapters.ros1.graph.state import MasterState
from bridge.messages.definitions.schema import PRIMITIVE_SIZES, Definition, FieldType, Schema, Shape
from bridge.messages.errors import ConversionError
from bridge.messages.transcode.conversion import SideType

TF_TYPES = ("tf2_msgs/TFMessage", "tf/tfMessage")

MAX_FRAMES = 100_000
"""Beyond this number, every frame is accepted, because a dropped frame of ``/tf_static`` would not be sent again."""

_HEADER = "std_msgs/Header"
_LENGTH = struct.Struct("<I")
_SIZES = {**PRIMITIVE_SIZES, "time": 8, "duration": 8}


class FrameId(NamedTuple):
    """A header's frame in a message's bytes; ``at`` is the offset of its length, ``where`` the path of the field.

    ``pose``: the header belongs to a stamped geometry, which is meaningless without a frame.
    """

    at: int
    frame: bytes
    where: str
    pose: bool


@dataclass(slots=True)
class _Walk:
    """A traversal of a message's bytes according to its definition."""

    schema: Schema
    data: bytes
    at: int = 0

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise ConversionError(f"{self.schema.name} is truncated: {len(self.data)} bytes")

    def count(self) -> int:
        self.skip(4)
        return int(_LENGTH.unpack_from(self.data, self.at - 4)[0])

    def message(self, definition: Definition, path: str) -> Iterator[FrameId]:
        for field in definition.fields:
            yield from self.field(definition, field.type, f"{path}{field.name}")

    def field(self, owner: Definition, kind: FieldType, path: str) -> Iterator[FrameId]:
        count = 1
        if kind.shape is Shape.ARRAY:
            count = kind.length
        elif kind.shape is Shape.SEQUENCE:
            count = self.count()
        if kind.base in _SIZES:
            self.skip(count * _SIZES[kind.base])
            return
        for _ in range(count):
            before = self.at
            if kind.base == _HEADER:
                self.skip(12)
                at, length = self.at, self.count()
                self.skip(length)
                stamped = owner.package == "geometry_msgs" and owner.name.endswith("Stamped")
                yield FrameId(at, self.data[at + 4 : self.at], f"{path}.frame_id", stamped)
            elif kind.nested:
                yield from self.message(self.schema.types[kind.base], f"{path}.")
            else:
                self.skip(self.count())
            if self.at == before:  # a message without fields; more of them would have no bytes either
                return


def has_headers(schema: Schema) -> bool:
    """Return whether a message of this type has headers."""
    return _HEADER in schema.types


def frames_in(schema: Schema, data: bytes) -> list[FrameId]:
    """Return the frames of all headers in a ROS 1 message, in order; raises `ConversionError` if it is malformed."""
    walk = _Walk(schema, data)
    frames = list(walk.message(schema.root, ""))
    if walk.at != len(data):
        raise ConversionError(f"{schema.name} has {len(data) - walk.at} bytes too many")
    return frames


def without_slashes(data: bytes, frames: list[FrameId]) -> bytes:
    """Return the message with the leading slashes of its frames removed."""
    for at, frame, *_ in reversed(frames):
        plain = frame.lstrip(b"/")
        if plain != frame:
            data = data[:at] + _LENGTH.pack(len(plain)) + plain + data[at + 4 + len(frame) :]
    return data


def empty(schema: Schema) -> bytes:
    """Return a ROS 1 message whose numbers are zero and whose strings and sequences are empty; all its bytes are 0."""
    return bytes(_empty_size(schema, schema.root))


def _empty_size(schema: Schema, definition: Definition) -> int:
    size = 0
    for kind in (field.type for field in definition.fields):
        if kind.shape is Shape.SEQUENCE:
            size += 4
            continue
        nested = kind.base not in _SIZES and kind.nested
        item = _empty_size(schema, schema.types[kind.base]) if nested else _SIZES.get(kind.base, 4)
        size += item * (kind.length if kind.shape is Shape.ARRAY else 1)
    return size


class KnownFrames:
    """The frames in a side's transforms."""

    def __init__(self) -> None:
        self._known: set[bytes] = set()
        self._full = False

    def learn(self, payload: bytes) -> None:
        """Learn the frames of a TFMessage; if it is malformed, those before the error."""
        if self._full:
            return
        with contextlib.suppress(struct.error):
            self._known.update(_transform_frames(payload))
        self._full = len(self._known) > MAX_FRAMES

    def __bool__(self) -> bool:
        """Return whether any transform has been received."""
        return bool(self._known)

    def trouble(self, frames: list[FrameId]) -> str:
        """Return why a goal in these frames is unreachable (a missing or unknown frame), "" if all are known."""
        for _, frame, where, pose in frames:
            if not frame and pose:
                return f"{where} is empty"
            if frame and frame not in self._known and not self._full:
                name = frame.decode(errors="replace")
                return f"no transform on /tf or /tf_static has the frame {name!r} of {where}"
        return ""


def _transform_frames(payload: bytes) -> Iterator[bytes]:
    """Yield both frames of each transform: Header, child_frame_id, then seven doubles."""
    (count,) = _LENGTH.unpack_from(payload)
    at = 4
    for _ in range(count):
        at += 12
        for _ in range(2):
            (length,) = _LENGTH.unpack_from(payload, at)
            yield payload[at + 4 : at + 4 + length].lstrip(b"/")
            at += 4 + length
        at += 56


_log = logging.getLogger(__name__)

KNOW_SECONDS = 2.0
"""A frame counts as unknown only once transforms have been received for this long and none of them has it."""

SILENT_SECONDS = 10.0
"""How long to wait for the first transform if topics for transforms exist; then every frame is accepted."""

_WARN_SECONDS = 60.0
_MAX_TOPICS = 100

_TF = SideType("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec", "")
"""tf/tfMessage has the same md5."""


class FrameGuard:
    """Receives the side's transforms while actions are open, and checks the frames of goals."""

    def __init__(self, network: ActionNetwork) -> None:
        self._network = network
        self._lock = threading.Lock()
        self._users: set[object] = set()
        self._topics: frozenset[str] = frozenset()
        self._subscriptions: dict[str, TopicSubscription] = {}
        self._frames = KnownFrames()
        self._opened = self._first_received = float("inf")
        self._reports: deque[tuple[float, str]] = deque(maxlen=10)

    def open(self, user: object) -> None:
        """Start receiving transforms for a user."""
        with self._lock:
            if not self._users:
                self._opened, self._first_received, self._frames = time.monotonic(), float("inf"), KnownFrames()
            self._users.add(user)
            self._update_subscriptions()

    def close(self, user: object) -> None:
        """Stop receiving transforms, unless there are other users."""
        with self._lock:
            self._users.discard(user)
            removed = self._update_subscriptions()
        for subscription in removed:
            subscription.close()

    def seen(self, state: MasterState | None) -> None:
        """Adopt the master's state: topics with transforms are recognized by type, not by name."""
        topics = sorted(t for t, kind in state.types.items() if kind in TF_TYPES) if state is not None else []
        with self._lock:
            self._topics = frozenset(topics[:_MAX_TOPICS])
            removed = self._update_subscriptions()
        for subscription in removed:
            subscription.close()

    def _update_subscriptions(self) -> list[TopicSubscription]:
        """Subscribe to missing topics; return superfluous subscriptions, which the caller closes without the lock."""
        wanted = self._topics if self._users and self._network.check_frames else frozenset()
        removed = [self._subscriptions.pop(topic) for topic in self._subscriptions.keys() - wanted]
        for topic in wanted - self._subscriptions.keys():
            self._subscriptions[topic] = self._network.subscribe(topic, _TF, self._on_transforms, "_frames")
        return removed

    def _on_transforms(self, payload: bytes, _source: str, _time: int | None) -> None:
        self._frames.learn(payload)
        if self._frames:
            self._first_received = min(self._first_received, time.monotonic())

    def check(self, schema: Schema, body: bytes) -> tuple[bytes, str | None]:
        """Check a goal's frames; raises `ConversionError` if the goal is malformed.

        Returns the goal without leading slashes in its frames, and why it must not be sent: "" if it may be sent, None
        if that is not known yet because too few transforms have been received.
        """
        if not self._network.check_frames or not has_headers(schema):
            return body, ""
        body = without_slashes(body, frames_in(schema, body))
        trouble = self._frames.trouble(frames_in(schema, body)) if self._topics else ""
        deadline = self._first_received + KNOW_SECONDS if self._frames else self._opened + SILENT_SECONDS
        if trouble and time.monotonic() < deadline:
            return body, None
        return body, trouble if self._frames else ""

    def report(self, action: str, trouble: str) -> None:
        """Report why a goal was rejected, because ROS 2's response has no text."""
        _log.warning("%s: a goal is rejected: %s", action, trouble)
        self._reports.append((time.monotonic(), f"{action}: a goal was rejected: {trouble}"))

    def warnings(self) -> list[str]:
        """Return the reports of the last minute."""
        return [text for at, text in list(self._reports) if at > time.monotonic() - _WARN_SECONDS]

"""The status of a recording."""

from __future__ import annotations

from pydantic import Field

from bridge.status import Int, Part, Text


class RecordedTopic(Part):
    """A recorded topic: its written messages, their size, and its dropped messages by reason."""

    topic: Text
    type: Text
    messages: Int
    bytes: Int
    dropped: dict[Text, Int]


class RecordingStatus(Part):
    """The status of a recording.

    Attributes:
        state: ``recording``, ``stopped``, or ``blocked`` while no file can be written; ``error`` is the reason.
        file: the current or last file, with ``file_messages`` messages in ``file_bytes`` bytes.
        files: number of files. ``ring``: whether they are a ring.
        messages: number of written messages. ``bytes``: their size. ``dropped``: dropped messages by reason.
    """

    state: Text
    file: Text
    file_bytes: Int
    file_messages: Int
    files: Int
    ring: bool
    messages: Int
    bytes: Int
    dropped: dict[Text, Int]
    error: Text
    topics: list[RecordedTopic] = Field(default=[])

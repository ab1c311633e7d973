"""Inserting many transforms at once, or a complete message, gives the same results as single insertions."""

from __future__ import annotations

import logging
import random
import struct
import threading

import pytest

from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import FrameRefusal, TransformError
from bridge.tf.intake import Sample
from tests.peers.ros1 import trees
from tests.support.wait import until

S = 1_000_000_000
START = 1_790_000_000 * S
UNIT = (0.0, 0.0, 0.0, 1.0)
SCHEMA = Registry().schema("tf2_msgs/msg/TFMessage")


def message(samples: list[Sample]) -> bytes:
    """Encode a TFMessage independently of the code under test."""
    return MessageWriter(SCHEMA).message({"transforms": [stamped(*sample) for sample in samples]})


def stamped(parent: str, child: str, stamp: int, moved: tuple, turned: tuple) -> dict:
    return {
        "header": {"stamp": dict(zip(("sec", "nanosec"), divmod(stamp, S), strict=True)), "frame_id": parent},
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", moved, strict=True)),
            "rotation": dict(zip("xyzw", turned, strict=True)),
        },
    }


def everything(buffer: TransformBuffer, names: list[str], stamps: list[int]) -> list:
    """Return a buffer's content, and its lookups of all names at up to 20 stamps."""
    answers: list[object] = [buffer.frames(), buffer.refused]
    for name in names:
        for stamp in stamps[:20]:
            try:
                answers.append(buffer.lookup_transform("f0", name, stamp))
            except TransformError as err:
                answers.append((type(err), str(err)))
    return answers


def test_batches_and_messages_equal_single_insertions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logging.getLogger("bridge.tf.intake"), "disabled", True)
    dice = random.Random(4)
    for _ in range(150):
        names = [f"f{k}" for k in range(6)]
        steps = trees.transforms(dice, names)
        stamps = [step[3] for step in steps] or [START]
        buffers = [TransformBuffer(max_future=20.0, now=lambda: trees.START) for _ in range(3)]
        answers: list[list[FrameRefusal | None]] = [[], [], []]
        while steps:
            static, count = steps[0][6], dice.randint(1, 5)
            together = 1
            while together < min(count, len(steps)) and steps[together][6] == static:
                together += 1
            samples, steps = [step[1:6] for step in steps[:together]], steps[together:]
            answers[0] += [buffers[0].set_transform(*sample, "me", static=static) for sample in samples]
            answers[1] += buffers[1].set_transforms(samples, "me", static=static)
            answers[2] += buffers[2].set_message(message(samples), "me", static=static)
        assert answers[1] == answers[0]
        assert answers[2] == answers[0]
        expected = everything(buffers[0], names, stamps)
        assert everything(buffers[1], names, stamps) == expected
        assert everything(buffers[2], names, stamps) == expected


def test_an_invalid_message_is_an_error_and_changes_nothing() -> None:
    buffer = TransformBuffer()
    whole = message([("map", "odom", START, (1, 2, 3), UNIT), ("odom", "base", START, (1, 2, 3), UNIT)])
    assert whole[-8:] == struct.pack("<d", 1.0)
    for end in range(len(whole)):
        with pytest.raises(ValueError, match="not a tf2_msgs/msg/TFMessage"):
            buffer.set_message(whole[:end])
    for at, value in ((1, b"\0"), (4, b"\3"), (4, b"\xff\xff\xff\xff"), (16, b"\xff\xff\xff\x7f"), (16, b"\3\0\0\0")):
        with pytest.raises(ValueError, match="not a tf2_msgs/msg/TFMessage"):
            buffer.set_message(whole[:at] + value + whole[at + len(value) :])
    assert not buffer.frames()
    assert buffer.set_message(whole) == [None, None]
    assert buffer.lookup_transform("map", "base", START).translation == (2, 4, 6)


def test_messages_fill_the_history() -> None:
    buffer = TransformBuffer()
    for n in range(300):
        assert buffer.set_message(message([("map", "base", START + n * S // 100, (n, 0, 0), UNIT)])) == [None]
    assert buffer.frames()[0].samples == 300
    poses = buffer.lookup_many("map", "base", [START + n * S // 100 for n in range(300)])
    assert poses.translations[:, 0].tolist() == list(range(300))


def test_large_messages_are_stored_and_unusual_transforms_refused() -> None:
    buffer = TransformBuffer()
    many = [("base", f"link{n}", START, (n, 0, 0), UNIT) for n in range(1000)]
    assert buffer.set_message(message(many), "arm") == [None] * 1000
    assert buffer.set_message(message([])) == []
    assert buffer.lookup_transform("base", "link999").translation == (999, 0, 0)
    assert buffer.set_message(message([("base", "link1", -S, (0, 0, 0), UNIT)])) == [FrameRefusal.INVALID_STAMP]
    odd = [("/base", "/größe", START, (5, 0, 0), UNIT), ("größe", "größe", START, (5, 0, 0), UNIT)]
    assert buffer.set_message(message(odd)) == [None, FrameRefusal.SELF_TRANSFORM]
    assert buffer.lookup_transform("base", "größe").translation == (5, 0, 0)


def test_a_message_inserts_a_removed_frame_again() -> None:
    buffer = TransformBuffer()
    for n in range(3):
        assert buffer.set_message(message([("a", "b", START + n, (n, 0, 0), UNIT)]), static=n == 1) == [None]
        assert buffer.lookup_transform("a", "b", START + (n if n != 1 else 77)).translation == (n, 0, 0)
        assert buffer.frames()[0].static == (n == 1)
        buffer.remove("b")


def test_a_batch_completes_a_waiting_lookup() -> None:
    buffer = TransformBuffer()
    answers: list[object] = []
    thread = threading.Thread(target=lambda: answers.append(buffer.lookup_transform("a", "d", timeout=40)))
    thread.start()
    until(lambda: buffer.waiting == 1, "the lookup waits", 30)
    before = buffer.changes
    buffer.set_message(message([(a, b, START, (1, 0, 0), UNIT) for a, b in ("ab", "bc", "cd")]))
    thread.join(30)
    assert answers[0].translation == (3, 0, 0)  # type: ignore[attr-defined]
    assert buffer.changes == before + 1

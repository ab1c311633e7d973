"""The buffer's kernels, compiled and as Python: identical results, and no access outside their memory."""

from __future__ import annotations

import importlib
import itertools
import logging
import random
import struct
import sys
import threading
import time
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

from bridge import kernels
from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import TransformError
from bridge.tf.layout import DONE
from tests.peers.ros1 import trees
from tests.support.uncompiled import uncompiled

S = 1_000_000_000
START = 1_790_000_000 * S
POSE = (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
TREES = 150
BOTH = (importlib.import_module, uncompiled)
SCHEMA = Registry().schema("tf2_msgs/msg/TFMessage")


def message(samples: list[tuple]) -> bytes:
    """Encode a TFMessage of (parent, child, stamp, translation, rotation)."""
    transforms_ = [
        {
            "header": {"stamp": {"sec": stamp // S, "nanosec": stamp % S}, "frame_id": parent},
            "child_frame_id": child,
            "transform": {
                "translation": dict(zip("xyz", moved, strict=True)),
                "rotation": dict(zip("xyzw", turned, strict=True)),
            },
        }
        for parent, child, stamp, moved, turned in samples
    ]
    return MessageWriter(SCHEMA).message({"transforms": transforms_})


def run(steps: list[tuple], dice: random.Random) -> list[object]:
    """Return all results of a buffer for the steps of a tree."""
    buffer = TransformBuffer()
    answers: list[object] = []
    for step in steps:
        if step[0] == "set":
            if dice.random() < 0.5:
                answers.append(buffer.set_message(message([step[1:6]]), "me", static=step[6]))
            else:
                answers.append(buffer.set_transform(*step[1:6], "me", static=step[6]))
        elif step[0] == "clear":
            buffer.clear()
        elif step[0] == "frames":
            answers.append(buffer.frames())
        else:
            further = dice.choice((0.0, 0.0, 0.5, 20.0))
            ask: Callable = buffer.lookup_transform if step[0] == "ask" else buffer.lookup_transform_full
            try:
                answers.append(ask(*step[1:], extrapolate=further))
                stamps = [trees.START + dice.randrange(-S, 10 * S) for _ in range(5)] + [0]
                fixed = step[1] if dice.random() < 0.5 else ""
                many = buffer.lookup_many(step[1], step[2 if step[0] == "ask" else 3], stamps, fixed_frame=fixed)
                answers += [many.stamps.tolist(), repr(many.translations.tolist()), repr(many.rotations.tolist())]
            except TransformError as err:
                answers.append((type(err), str(err)))
    return answers


def test_compiled_and_python_give_the_same_results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logging.getLogger("bridge.tf.intake"), "disabled", True)
    cases = list(trees.cases(11, TREES))
    compiled = [run(steps, random.Random(n)) for n, steps in enumerate(cases)]
    history, reader = uncompiled("bridge.tf.history"), uncompiled("bridge.tf.message")
    monkeypatch.setattr("bridge.tf.buffer.TransformHistory", history.TransformHistory)
    monkeypatch.setattr("bridge.tf.intake.pose_flaw", history.pose_flaw)
    monkeypatch.setattr("bridge.tf.intake.message", reader)
    monkeypatch.setattr("bridge.tf.buffer.compose", history.compose)
    monkeypatch.setattr("bridge.tf.buffer.compose_many", history.compose_many)
    for n, steps in enumerate(cases):
        assert run(steps, random.Random(n)) == compiled[n], f"case {n}"


@pytest.fixture(params=BOTH, ids=("compiled", "uncompiled"))
def history(request: pytest.FixtureRequest) -> ModuleType:
    return request.param("bridge.tf.history")


@pytest.fixture(params=BOTH, ids=("compiled", "uncompiled"))
def reader(request: pytest.FixtureRequest) -> ModuleType:
    return request.param("bridge.tf.message")


@pytest.mark.parametrize("frame", [-(1 << 63), -1, 0, 64, 1 << 40, (1 << 63) - 1])
def test_a_frame_without_a_row_is_refused(history: ModuleType, frame: int) -> None:
    rings = history.TransformHistory(S)
    rings.begin(1, False)
    assert rings.insert(1, 2, START, POSE) == DONE
    for call in (
        lambda: rings.begin(frame, False),
        lambda: rings.insert(frame, 1, START, POSE),
        lambda: rings.insert(1, frame, START + 1, POSE),
        lambda: rings.insert_at(1, frame, START + 1, bytes(56), 0),
        lambda: rings.lookup(frame, 1, START, 0),
        lambda: rings.lookup(1, frame, START, 0),
        lambda: rings.lookup_many(frame, 1, np.array([START]), 0),
        lambda: rings.lookup_many(1, frame, np.array([START]), 0),
        lambda: rings.newest(frame),
        lambda: rings.ends(frame),
        lambda: rings.remove(frame),
    ):
        with pytest.raises(IndexError, match="no row"):
            call()
    assert rings.ends(1) == (START, START, 1)


def test_writes_outside_the_rings_are_refused(history: ModuleType) -> None:
    rings = history.TransformHistory(S)
    with pytest.raises(ValueError, match="no ring"):
        rings.insert(1, 2, START, POSE)
    rings.begin(1, False)
    for stamp in (-1, 1 << 62):
        with pytest.raises(ValueError, match="146 years"):
            rings.insert(1, 2, stamp, POSE)
    for span in (-1, 1 << 63):
        with pytest.raises(ValueError, match="146 years"):
            history.TransformHistory(span)
    cdr = bytes(4) + struct.pack("<7d", *POSE)
    for at in (-1, 5, 60, 1 << 40):
        with pytest.raises(IndexError, match="no pose"):
            rings.insert_at(1, 2, START, cdr, at)
    assert rings.insert_at(1, 2, START, cdr, 4) == DONE
    assert rings.lookup(2, 1, START, 0) == (POSE[:3], POSE[3:], START)
    for poses in (np.zeros((3, 6)), np.zeros((3, 8))):
        with pytest.raises(ValueError, match="each must have 7"):
            history.compose_many(poses, POSE[:3], POSE[3:])
    history.TransformHistory.__new__(history.TransformHistory)  # freeing an object without memory is harmless


@pytest.mark.parametrize("stamp", [-(1 << 63), -(1 << 62) - 1, -1, (1 << 62) + 1, (1 << 63) - 1])
def test_a_stamp_out_of_range_has_no_pose(history: ModuleType, stamp: int) -> None:
    rings = history.TransformHistory(10 * S)
    rings.begin(1, False)
    for n in range(5):
        rings.insert(1, 2, START + n, POSE)
    assert rings.lookup(2, 1, stamp, 0) is None
    assert rings.failure()[1] == stamp
    assert rings.failure()[2] == (START if stamp < 0 else START + 4)


def test_growing_rings_do_not_overlap(history: ModuleType) -> None:
    rings = history.TransformHistory(1000 * S)
    frames = range(2, 100, 9)
    for frame in frames:
        rings.make_room(frame)
        rings.begin(frame, False)
    for n in range(700):
        for frame in frames:
            assert rings.insert(frame, 1, START + n * S, (float(frame), float(n), *POSE[2:])) == DONE
    for frame in frames:
        assert rings.ends(frame) == (START, START + 699 * S, 700)
        for n in range(0, 700, 50):
            result = rings.lookup(1, frame, START + n * S, 0)
            assert result == ((float(frame), float(n), 3.0), POSE[3:], START + n * S)


def test_a_sample_is_found_at_any_rate(history: ModuleType) -> None:
    dice = random.Random(5)
    for _ in range(30):
        rings = history.TransformHistory(1 << 60)
        rings.begin(1, False)
        gaps = [dice.choice((1, 10, 10**6, 10**12)) for _ in range(dice.randint(2, 60))]
        stamps = [sum(gaps[:n]) + 1 for n in range(1, len(gaps))] or [1]
        for stamp in dice.sample(stamps, len(stamps)):
            rings.insert(1, 2, stamp, (float(stamp), *POSE[1:]))
        for stamp in stamps:
            assert rings.lookup(2, 1, stamp, 0)[0][0] == float(stamp)
        for before, after in itertools.pairwise(stamps):
            middle = before + (after - before) // 3
            assert rings.lookup(2, 1, middle, 0)[0][0] == pytest.approx(middle, rel=1e-15)


def test_invalid_messages_raise_in_both_forms() -> None:
    dice = random.Random(8)
    forms = [form("bridge.tf.message") for form in BOTH]
    whole = message([("map", "odom", START, *((1, 2, 3), (0, 0, 0, 1))), ("odom", "größe", 5, (1, 2, 3), (0, 0, 0, 1))])
    invalid = 0
    for _ in range(3000):
        broken = bytearray(whole[: dice.randint(0, len(whole))] if dice.random() < 0.3 else whole)
        for _ in range(dice.randint(0, 3)):
            if broken:
                at = dice.randrange(len(broken))
                broken[at] = dice.choice((0, 1, 4, 7, 127, 128, 255, dice.randrange(256)))
        errors = []
        for form in forms:
            try:
                errors.append([(stamp, *form.split_names(names), at) for stamp, names, at in form.read(bytes(broken))])
            except ValueError as err:
                errors.append(str(err))
                invalid += 1
        assert errors[0] == errors[1]
    assert 1000 < invalid < 5000


def test_a_message_is_read_to_its_last_byte(reader: ModuleType) -> None:
    cdr = message([("/map", "größe", -1, (1, 2, 3), (0, 0, 0, 1)), ("", "", 7, (4, 5, 6), (0, 0, 0, 1))])
    (stamp, names, at), (other_stamp, other_names, other_at) = reader.read(cdr)
    assert (stamp, reader.split_names(names)) == (-1, ("/map", "größe"))
    assert struct.unpack_from("<7d", cdr, at) == (1, 2, 3, 0, 0, 0, 1)
    assert (other_stamp, reader.split_names(other_names)) == (7, ("", ""))
    assert other_at == len(cdr) - 56


@pytest.mark.skipif(kernels.built("bridge.tf.history") is None, reason="the kernel is not compiled")
def test_lookup_many_releases_the_gil() -> None:
    buffer = TransformBuffer()
    for k in range(900):
        for n in range(2):
            buffer.set_transform(f"f{k}", f"f{k + 1}", START + n * S, POSE[:3], POSE[3:])
    stamps = [START + n for n in range(70)]  # so few that NumPy does not release the GIL
    began, ran = threading.Event(), threading.Event()

    def other() -> None:
        began.wait(60)
        ran.set()

    thread = threading.Thread(target=other)
    thread.start()
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1000)  # no thread is forced to yield
    try:
        began.set()
        end = time.monotonic() + 30
        while not ran.is_set() and time.monotonic() < end:
            buffer.lookup_many("f0", "f900", stamps)
        assert ran.is_set()
    finally:
        sys.setswitchinterval(usual)
        thread.join(30)

"""Results, errors and refusals, compared with those of the real tf2 of ROS 1 for the same trees and lookups."""

from __future__ import annotations

import logging
import marshal
import os
import re
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

import pytest

from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import TransformError
from tests.peers.ros1 import trees
from tests.peers.ros1.network import ROS1_PYTHON, needs_ros1, ros1_environment

TREES = int(os.environ.get("MIDSPAN_TF_TREES", "10000"))
TOLERANCE = 1e-9
PEER = Path(__file__).parents[1] / "peers" / "ros1" / "tf2_peer.py"
NAMES = {
    "LookupError_": "LookupException",
    "ConnectivityError": "ConnectivityException",
    "ExtrapolationError": "ExtrapolationException",
    "InvalidArgumentError": "InvalidArgumentException",
}
CUT = (116, 162)
"""Lengths at which tf2 truncates texts (cache.cpp: char str[117], str[163])."""
Answer = tuple


def ask(buffer: TransformBuffer, step: tuple) -> Answer:
    try:
        transform = buffer.lookup_transform(*step[1:]) if step[0] == "ask" else buffer.lookup_transform_full(*step[1:])
    except TransformError as err:
        return NAMES[type(err).__name__], str(err)
    return transform.stamp, *transform.translation, *transform.rotation


def differ(ours: Answer | str, theirs: Answer | str) -> bool:
    if isinstance(ours, str) or isinstance(theirs, str):
        return frames(ours) != frames(theirs)
    if len(ours) != len(theirs):
        return True
    if len(ours) == 2:
        return ours[0] != theirs[0] or not same_text(ours[1], theirs[1])
    return ours[0] != theirs[0] or not all(abs(a - b) <= TOLERANCE for a, b in zip(ours[1:], theirs[1:], strict=True))


def frames(text: str) -> dict[str, set[str]]:
    """Parse the frames of a YAML text, in any order and with any quotes."""
    frames_: dict[str, set[str]] = {}
    name = ""
    for line in "" if text == "{}" else text.replace('"', "").replace("'", "").splitlines():
        if line.startswith(" "):
            frames_[name].add(line.rstrip())
        else:
            name = line.strip()
            frames_[name] = set()
    return frames_


def same_text(ours: str, theirs: str) -> bool:
    """Compare texts: tf2 lists all frames after the text for a loop, and truncates the text about times."""
    first_line, _, between = theirs.split("\n")[0].partition(", when")
    mine, _, ours_between = ours.partition(", when")
    return between == ours_between and (mine == first_line or (len(first_line) in CUT and mine.startswith(first_line)))


@pytest.mark.thorough
@needs_ros1
def test_results_and_errors_equal_tf2s(monkeypatch: pytest.MonkeyPatch) -> None:
    seed = int.from_bytes(os.urandom(4), "big")
    monkeypatch.setattr(logging.getLogger("bridge.tf.intake"), "disabled", True)  # each buffer logs its first refusal
    refused = Counter[str]()
    ours, questions = [], []
    with tempfile.TemporaryFile() as log:
        command = [ROS1_PYTHON, PEER, str(seed), str(TREES)]
        with subprocess.Popen(command, env=ros1_environment(), stdout=subprocess.PIPE, stderr=log) as peer:
            for steps in trees.cases(seed, TREES):
                buffer = TransformBuffer()
                for step in steps:
                    if step[0] == "set":
                        buffer.set_transform(*step[1:6], "peer", static=step[6])
                    elif step[0] == "clear":
                        buffer.clear()
                    elif step[0] == "frames":
                        ours.append(buffer.yaml())
                        questions.append((steps, step))
                    else:
                        ours.append(ask(buffer, step))
                        questions.append((steps, step))
                refused.update(buffer.refused)
            output, _ = peer.communicate()
        log.seek(0)
        tf2_log = log.read().decode(errors="replace")
    assert peer.returncode == 0, tf2_log[-2000:]
    theirs = marshal.loads(output)
    assert len(ours) == len(theirs) == 6 * TREES
    wrong = [(a, b, *q) for a, b, q in zip(ours, theirs, questions, strict=True) if differ(a, b)]
    if wrong:
        pytest.fail(f"seed {seed}: {len(wrong)} differ; the first: {wrong[0]}")
    kinds = Counter(answer[0] if len(answer) == 2 else "found" for answer in ours if not isinstance(answer, str))
    assert min(kinds[name] for name in ("found", *NAMES.values())) > TREES // 100, kinds
    # tf2 logs every flaw of a transform, so each of ours is in its log at least as often
    logged = Counter(re.findall(r"\b(TF_[A-Z_]+)", tf2_log))
    assert set(refused) == set(logged)
    assert all(logged[reason] >= count for reason, count in refused.items()), (seed, refused, logged)
    assert all(refused[reason] == logged[reason] for reason in ("TF_OLD_DATA", "TF_REPEATED_DATA")), (
        seed,
        refused,
        logged,
    )

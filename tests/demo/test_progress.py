"""What counts as progress while a demo comes up and drives, and what is said where there is none."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.daemon.query import Phase
from bridge.demo import progress as progress_module
from bridge.demo.processes import DemoChild
from bridge.demo.progress import STILL_SECONDS, DemoProgress, Parts, PartState
from bridge.demo.sandbox import Sandbox


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def progress() -> tuple[DemoProgress, Clock]:
    clock = Clock()
    return DemoProgress(clock), clock


def test_what_is_new_is_progress_and_what_is_said_again_is_none() -> None:
    made, clock = progress()
    for word in ("importing rclpy", "joining", "importing rclpy", "joining"):
        clock.now += 20.0
        made.note("ros2", word)
    assert made.still == 40.0
    clock.now += STILL_SECONDS
    assert made.stalled
    made.begin()
    assert not made.stalled
    assert made.note("ros2", "joining"), "of what is waited for now it is the first word"


def test_seconds_that_are_counted_are_no_progress_unless_they_are_meant() -> None:
    made, clock = progress()
    made.note("modules", "silent for 1.5 s")
    clock.now += 5.0
    made.note("modules", "silent for 6.5 s")
    assert made.still == 5.0
    made.note("scan", "12 heard", numbers=True)
    clock.now += 5.0
    made.note("scan", "13 heard", numbers=True)
    assert made.still == 0.0


def test_a_robot_moves_by_its_way_and_by_turning_and_not_by_noise() -> None:
    made, clock = progress()
    made.note_pose(1.0, 1.0, 3.1)
    for place in ((1.05, 1.0, 3.1), (1.0, 1.05, -3.1)):
        clock.now += 1.0
        made.note_pose(*place)
    assert made.still == 2.0
    made.note_pose(1.2, 1.0, 3.1)
    assert made.still == 0.0
    clock.now += 1.0
    made.note_pose(1.2, 1.0, -2.7)
    assert made.still == 0.0


BUSY = "import time\nwhile time.process_time() < 2.0: pass\nprint('done', flush=True)\ntime.sleep(600)"


def test_a_process_that_computes_while_it_starts_is_progress() -> None:
    made, clock = progress()
    with subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE) as busy:
        try:
            made.note_work([busy.pid])
            clock.now += 10.0
            assert busy.stdout is not None
            busy.stdout.readline()
            made.note_work([busy.pid])
            assert made.still == 0.0
            clock.now += 10.0
            made.note_work([busy.pid])
            assert made.still == 10.0, "it sleeps"
        finally:
            busy.kill()


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the daemon says of its workers."""
    said: dict[str, Any] = {"workers": []}
    monkeypatch.setattr(progress_module, "ask_daemon", lambda _config: said)
    monkeypatch.setattr(progress_module, "_ASK_EVERY", -1.0)
    return said


def worker(name: str, phase: Phase, text: str = "", restarts: int = 0) -> dict[str, Any]:
    return {"worker": name, "phase": phase.value, "text": text, "pid": os.getpid(), "restarts": restarts}


def daemon(words: str) -> DemoChild:
    return cast("DemoChild", SimpleNamespace(pid=os.getpid(), last_output=lambda: words))


def looked(words: str = "") -> tuple[Parts, DemoProgress, Clock]:
    made, clock = progress()
    here = cast("Sandbox", SimpleNamespace(config=None))
    found = Parts(here, {"daemon": daemon(words)})
    found.refresh(made)
    return found, made, clock


def test_a_worker_that_cannot_work_or_dies_again_and_again_has_failed(told: dict[str, Any]) -> None:
    told["workers"] = [worker("ros1", Phase.UP), worker("ros2", Phase.STARTING, "importing rclpy")]
    assert looked()[0].failed is None
    told["workers"][1] = worker("ros2", Phase.PAUSED, "died", restarts=1)
    assert looked()[0].failed is None, "it is started again"
    told["workers"][1] = worker("ros2", Phase.PAUSED, "died", restarts=3)
    assert looked()[0].failed is not None
    told["workers"][1] = worker("ros2", Phase.FAILED, "no rclpy for this Python")
    found = looked("12:00:01 ros1: running\n12:00:02 ros2 cannot work: no rclpy for this Python")[0]
    assert found.failed == PartState("ros2", "cannot work", "no rclpy for this Python", os.getpid())
    words = found.failure_text(found.failed)
    assert "ros2: cannot work, no rclpy for this Python" in words
    assert "12:00:02 ros2 cannot work" in words
    assert "ros1" not in words
    assert "midspan doctor" in words


def test_who_does_not_come_is_named_with_its_last_words_and_what_to_try(told: dict[str, Any]) -> None:
    told["workers"] = [
        worker("ros1", Phase.UP, "3 routes"),
        worker("modules", Phase.UP, "waiting: robot_goto: no scan"),
    ]
    words = looked("modules: a warning of its own")[0].stall_text("the robot")
    assert "nothing has moved for 60 s, and the robot is not there" in words
    assert "modules: running, waiting: robot_goto: no scan" in words
    assert "a warning of its own" in words
    assert "ros1" not in words
    assert "What to try" in words


def test_what_a_worker_is_at_is_progress(told: dict[str, Any]) -> None:
    told["workers"] = [worker("ros2", Phase.UP, "importing rclpy")]
    found, made, clock = looked()
    clock.now += 30.0
    found.refresh(made)
    assert made.still == 30.0
    told["workers"] = [worker("ros2", Phase.UP, "opening its session")]
    found.refresh(made)
    assert made.still == 0.0


def test_a_demo_whose_driving_would_be_refused_says_so_before_it_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    from bridge import kernels
    from bridge.demo import sandbox

    monkeypatch.setattr(kernels, "state", lambda: kernels.KernelState(("navigation.some_kernel",), ()))
    assert kernels.CURE in sandbox.too_slow()[0]
    monkeypatch.setattr(kernels, "state", lambda: kernels.KernelState((), ("navigation.some_kernel",)))
    assert sandbox.too_slow() == []


def test_the_last_words_of_a_folder_that_is_gone_are_none(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    folder.mkdir()
    child = DemoChild("short", [sys.executable, "-c", "pass"], dict(os.environ), folder)
    child.begin_stop()
    child.finish_stop(20.0)
    shutil.rmtree(folder)
    assert child.last_output() == "(exit code 0)"


def test_the_last_words_are_whole_lines(tmp_path: Path) -> None:
    line = "tried again in 3 s: " + "x" * 400
    code = f"import sys; print('\\n'.join([{line!r}] * 20), file=sys.stderr)"
    child = DemoChild("wordy", [sys.executable, "-c", code], dict(os.environ), tmp_path)
    child.begin_stop()
    child.finish_stop(20.0)
    assert child.last_output().splitlines() == [line, line, line, "(exit code 0)"]

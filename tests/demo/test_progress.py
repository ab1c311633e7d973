"""What counts as progress while a demo starts and drives, and the messages if there is none."""

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
from bridge.status import read_daemon_status


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def progress() -> tuple[DemoProgress, Clock]:
    clock = Clock()
    return DemoProgress(clock), clock


def test_new_texts_are_progress_and_repeated_ones_are_not() -> None:
    demo_progress, clock = progress()
    for line in ("importing rclpy", "joining", "importing rclpy", "joining"):
        clock.now += 20.0
        demo_progress.note("ros2", line)
    assert demo_progress.still == 40.0
    clock.now += STILL_SECONDS
    assert demo_progress.stalled
    demo_progress.begin()
    assert not demo_progress.stalled
    assert demo_progress.note("ros2", "joining"), "the text is the first one for the new condition"


def test_changed_numbers_are_progress_only_on_request() -> None:
    demo_progress, clock = progress()
    demo_progress.note("modules", "silent for 1.5 s")
    clock.now += 5.0
    demo_progress.note("modules", "silent for 6.5 s")
    assert demo_progress.still == 5.0
    demo_progress.note("scan", "12 heard", numbers=True)
    clock.now += 5.0
    demo_progress.note("scan", "13 heard", numbers=True)
    assert demo_progress.still == 0.0


def test_motion_and_rotation_are_progress_and_noise_is_not() -> None:
    demo_progress, clock = progress()
    demo_progress.note_pose(1.0, 1.0, 3.1)
    for place in ((1.05, 1.0, 3.1), (1.0, 1.05, -3.1)):
        clock.now += 1.0
        demo_progress.note_pose(*place)
    assert demo_progress.still == 2.0
    demo_progress.note_pose(1.2, 1.0, 3.1)
    assert demo_progress.still == 0.0
    clock.now += 1.0
    demo_progress.note_pose(1.2, 1.0, -2.7)
    assert demo_progress.still == 0.0


BUSY = "import time\ninput()\nwhile time.process_time() < 2.0: pass\nprint('done', flush=True)\ntime.sleep(600)"


def test_processor_time_of_a_starting_process_is_progress() -> None:
    demo_progress, clock = progress()
    with subprocess.Popen([sys.executable, "-c", BUSY], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as busy:
        try:
            demo_progress.note_work([busy.pid])
            clock.now += 10.0
            assert busy.stdin is not None
            assert busy.stdout is not None
            busy.stdin.write(b"\n")  # computes only now
            busy.stdin.flush()
            busy.stdout.readline()
            demo_progress.note_work([busy.pid])
            assert demo_progress.still == 0.0
            clock.now += 10.0
            demo_progress.note_work([busy.pid])
            assert demo_progress.still == 10.0, "the process sleeps"
        finally:
            busy.kill()


@pytest.fixture
def daemon_status(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The status that the daemon reports of its workers, which the test changes."""
    status: dict[str, Any] = {"workers": []}
    monkeypatch.setattr(progress_module, "ask_daemon", lambda _config: read_daemon_status(status))
    monkeypatch.setattr(progress_module, "_ASK_EVERY", -1.0)
    return status


def worker(name: str, phase: Phase, text: str = "", restarts: int = 0) -> dict[str, Any]:
    return {"worker": name, "phase": phase.value, "text": text, "pid": os.getpid(), "restarts": restarts}


def daemon(text: str) -> DemoChild:
    return cast("DemoChild", SimpleNamespace(pid=os.getpid(), last_output=lambda: text))


def refreshed(text: str = "") -> tuple[Parts, DemoProgress, Clock]:
    demo_progress, clock = progress()
    sandbox = cast("Sandbox", SimpleNamespace(config=None))
    parts = Parts(sandbox, {"daemon": daemon(text)})
    parts.refresh(demo_progress)
    return parts, demo_progress, clock


def test_a_worker_that_cannot_work_or_restarts_repeatedly_has_failed(daemon_status: dict[str, Any]) -> None:
    daemon_status["workers"] = [worker("ros1", Phase.UP), worker("ros2", Phase.STARTING, "importing rclpy")]
    assert refreshed()[0].failed is None
    daemon_status["workers"][1] = worker("ros2", Phase.PAUSED, "died", restarts=1)
    assert refreshed()[0].failed is None, "the worker is being restarted"
    daemon_status["workers"][1] = worker("ros2", Phase.PAUSED, "died", restarts=3)
    assert refreshed()[0].failed is not None
    daemon_status["workers"][1] = worker("ros2", Phase.FAILED, "no rclpy for this Python")
    parts = refreshed("12:00:01 ros1: running\n12:00:02 ros2 cannot work: no rclpy for this Python")[0]
    assert parts.failed == PartState("ros2", "cannot work", "no rclpy for this Python", os.getpid())
    text = parts.failure_text(parts.failed)
    assert "ros2: cannot work, no rclpy for this Python" in text
    assert "12:00:02 ros2 cannot work" in text
    assert "ros1" not in text
    assert "midspan doctor" in text


def test_a_stalled_part_is_named_with_its_last_output_and_advice(daemon_status: dict[str, Any]) -> None:
    daemon_status["workers"] = [
        worker("ros1", Phase.UP, "3 routes"),
        worker("modules", Phase.UP, "waiting: robot_goto: no scan"),
    ]
    text = refreshed("modules: a separate warning")[0].stall_text("the robot")
    assert "no progress for 60 s while waiting for the robot" in text
    assert "modules: running, waiting: robot_goto: no scan" in text
    assert "a separate warning" in text
    assert "ros1" not in text
    assert "free -m" in text


def test_a_workers_new_phase_is_progress(daemon_status: dict[str, Any]) -> None:
    daemon_status["workers"] = [worker("ros2", Phase.UP, "importing rclpy")]
    parts, demo_progress, clock = refreshed()
    clock.now += 30.0
    parts.refresh(demo_progress)
    assert demo_progress.still == 30.0
    daemon_status["workers"] = [worker("ros2", Phase.UP, "opening its session")]
    parts.refresh(demo_progress)
    assert demo_progress.still == 0.0


def test_a_demo_without_compiled_kernels_is_refused_before_it_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    from bridge import kernels
    from bridge.demo import sandbox

    monkeypatch.setattr(kernels, "state", lambda: kernels.KernelState(("navigation.some_kernel",), ()))
    assert kernels.CURE in sandbox.too_slow()[0]
    monkeypatch.setattr(kernels, "state", lambda: kernels.KernelState((), ("navigation.some_kernel",)))
    assert sandbox.too_slow() == []


def test_the_last_output_without_a_log_file_is_empty(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    folder.mkdir()
    child = DemoChild("short", [sys.executable, "-c", "pass"], dict(os.environ), folder)
    child.begin_stop()
    child.finish_stop(20.0)
    shutil.rmtree(folder)
    assert child.last_output() == "(exit code 0)"


def test_the_last_output_has_complete_lines(tmp_path: Path) -> None:
    line = "tried again in 3 s: " + "x" * 400
    code = f"import sys; print('\\n'.join([{line!r}] * 20), file=sys.stderr)"
    child = DemoChild("wordy", [sys.executable, "-c", code], dict(os.environ), tmp_path)
    child.begin_stop()
    child.finish_stop(20.0)
    assert child.last_output().splitlines() == [line, line, line, "(exit code 0)"]

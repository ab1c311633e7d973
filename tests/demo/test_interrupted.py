"""Ctrl-C at any moment ends the demo within 3 s, and leaves nothing behind."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from bridge.demo import leftovers as left
from bridge.demo.shutdown import SECONDS, Shutdown
from tests.demo.test_demo import leftovers, processes_of, start
from tests.support.missing import COMPILER, DART, ROS1, ROS2, needs
from tests.support.processor_share import ProcessorShare
from tests.support.wait import until

MEMORY = Path("/dev/shm")

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.alone,
    *(needs(reason) for reason in (ROS1, ROS2, DART, COMPILER)),
]


@pytest.fixture
def folder() -> Iterator[Path]:
    """Yield a folder with a short path.

    In pytest's own folder, the names of the daemon's sockets would be too long, so the demo would use /tmp instead.
    """
    with tempfile.TemporaryDirectory(prefix="midspan-t-") as name:
        yield Path(name)


def runs(folder: Path, *parts: str) -> bool:
    """Return whether each part is in the command of a process of the demo."""
    return all(any(part in line for line in processes_of(folder)) for part in parts)


def memory(folder: Path) -> set[Path]:
    """Return the demo processes' files in shared memory, except LTTng's, which the user's processes share and keep."""
    runs_in = [folder_ for folder_ in folder.iterdir() if folder_.name.startswith("midspan-demo-")]
    used = {file for run in runs_in for pid in left.marked(run) for file in left.used_by(pid)}
    return {file for file in used if not file.name.startswith("lttng-")}


def assert_ends(demo: subprocess.Popen[str], folder: Path, number: signal.Signals = signal.SIGINT) -> None:
    """Send the signal, and check that the demo ends in time without leftovers."""
    used = memory(folder)
    share, began = ProcessorShare(), time.monotonic()
    demo.send_signal(number)
    output, _ = demo.communicate(timeout=60)
    took = time.monotonic() - began
    assert took < SECONDS / share.least(), output
    assert demo.returncode not in (0, None)
    assert "Traceback" not in (output or "")
    assert leftovers(folder) == []
    assert left.remove_unused(used) == []


MOMENTS = {
    "it sets up its folder": lambda folder, _words: any(folder.glob("midspan-demo-*")),
    "roscore starts": lambda folder, _words: runs(folder, "roscore"),
    "the daemon starts": lambda folder, _words: runs(folder, "bridge.cli.main"),
    "a client starts": lambda folder, _words: runs(folder, "goto_location_yarp"),
    "the robot drives": lambda _folder, output: "status_moving" in output.read_text(),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_ctrl_c_ends_the_demo_in_time_and_leaves_nothing_behind(folder: Path, moment: str) -> None:
    output = folder / "words.txt"
    with output.open("w") as out:
        demo = start(folder, "--stay", what="rooms", out=out)
        try:
            reached = MOMENTS[moment]
            until(lambda: demo.poll() is not None or reached(folder, output), moment, 120.0)
            assert demo.poll() is None, output.read_text()
            assert_ends(demo, folder)
        finally:
            demo.kill()
    assert "Traceback" not in output.read_text()


@pytest.mark.parametrize("seconds", [0.5, 1.5, 2.5, 4.0])
def test_ctrl_c_during_the_start_ends_the_demo_in_time(folder: Path, seconds: float) -> None:
    demo = start(folder, "--stay")
    try:
        time.sleep(seconds)
        used = psutil.Process(demo.pid).cpu_times
        until(lambda: sum(used()[:2]) > 0.2, "Python has started; until then it prints a traceback", 60.0)
        assert_ends(demo, folder)
    finally:
        demo.kill()


@pytest.mark.parametrize(
    ("number", "program"), [(signal.SIGTERM, "bridge.demo.topics_demo.robot"), (signal.SIGHUP, "bridge.cli.main")]
)
def test_other_signals_end_the_demo_in_time(folder: Path, number: signal.Signals, program: str) -> None:
    demo = start(folder, "--stay")
    try:
        until(lambda: runs(folder, program), f"{program} runs", 120.0)
        assert_ends(demo, folder, number)
    finally:
        demo.kill()


STUCK = """
import signal, sys, time
from bridge.demo.shutdown import Shutdown
with Shutdown() as ending:
    ending.guard(lambda: 1 / 0)
    ending.guard(lambda: print("erased", flush=True))
    ending.ignore_signals()
    print("stuck", flush=True)
    time.sleep(600)
"""


def test_a_hanging_demo_is_ended_in_time(tmp_path: Path) -> None:
    """For example, Python may wait for a library's thread."""
    command = [sys.executable, "-c", STUCK]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as stuck:
        assert stuck.stdout is not None
        assert stuck.stdout.readline() == "stuck\n"
        share, began = ProcessorShare(), time.monotonic()
        for _ in range(3):  # an impatient user
            stuck.send_signal(signal.SIGINT)
        assert stuck.wait(60) == 130
        assert time.monotonic() - began < SECONDS / share.least()
        assert stuck.stdout.read() == "erased\n"


def test_the_demo_does_not_search_for_leftovers_twice_at_the_same_time() -> None:
    code = """
import os, signal, time
from bridge.demo import shutdown
from bridge.demo.shutdown import Shutdown
shutdown._ERASE_SECONDS = 30.0  # much longer than the main thread takes
with Shutdown() as ending:
    ending.guard(lambda: print("guarded", flush=True))
    ending.ignore_signals()
    os.kill(os.getpid(), signal.SIGINT)
    with ending.erasing():
        time.sleep(2.2)
        print("erased", flush=True)
    time.sleep(600)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout.split(), done.returncode) == (["erased", "guarded"], 130), done.stderr


def test_an_interrupt_during_the_imports_ends_the_demo_without_freeing_them() -> None:
    code = """
import argparse, builtins, sys
from bridge.demo.command import run
class Freed:
    def __del__(self):
        print("freed", flush=True)
class Interrupted:
    def find_spec(self, name, path, target=None):
        if name == "bridge.demo.shutdown":
            raise KeyboardInterrupt
builtins.freed = Freed()
sys.meta_path.insert(0, Interrupted())
run(argparse.Namespace())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.returncode) == ("", 130), done.stderr


def test_a_signal_is_deferred_by_a_held_block_and_raised_once() -> None:
    code = """
import os, signal
from bridge.demo.shutdown import Shutdown
with Shutdown() as ending:
    try:
        with ending.held():
            os.kill(os.getpid(), signal.SIGINT)
            print("whole", flush=True)
        print("never", flush=True)
    except KeyboardInterrupt:
        print("raised", flush=True)
    ending.ignore_signals()
    os.kill(os.getpid(), signal.SIGINT)
    ending.check()
    print("undone", flush=True)
ending.exit_if_interrupted(3)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout.split(), done.returncode) == (["whole", "raised", "undone"], 3), done.stderr


def test_signal_handlers_are_restored_without_a_signal() -> None:
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    threads = psutil.Process().num_threads()
    with Shutdown() as ending:
        assert not ending.interrupted
        assert signal.getsignal(signal.SIGINT) not in before
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
    until(lambda: psutil.Process().num_threads() <= threads, "the demo's thread ends", 20.0)

"""While the processors do not keep up, the test files of one run start one after the other."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import turns
from tests.support.inner_run import ROOT, run_tests
from tests.support.process import Process
from tests.support.turns import READY, Turns, ready
from tests.support.wait import until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux publishes the number of ready threads")

HOLD = """
import signal
import sys
from pathlib import Path
from tests.support.turns import Turns

with Path(sys.argv[1]).open("ab") as file:
    Turns(file, 1).take()
    print("taken", flush=True)
    signal.pause()
"""

CONFTEST = """
import signal
from pathlib import Path

import pytest

from tests.support import turns
from tests.support.scheduler import Scheduler

def ready():
    with Path("timers").open("a") as timers:
        timers.write(f"{signal.getitimer(signal.ITIMER_REAL)[0]}\\n")
    return 1000.0

turns.ready = ready

def pytest_configure(config):
    turns.pytest_configure(config)

def pytest_xdist_make_scheduler(config, log):
    return Scheduler(config, log)

@pytest.fixture(autouse=True)
def logged(request):
    with Path("log").open("a") as log:
        log.write(f"{request.path.name}\\n")
    yield
    with Path("log").open("a") as log:
        log.write(f"{request.path.name}\\n")
"""

FILE = """
import time
import pytest

@pytest.mark.parametrize("number", range(3))
def test_takes_time(number):
    time.sleep(0.3)
"""


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Turns]:
    with (tmp_path / "turns").open("ab") as file:
        yield Turns(file, 0)


@pytest.fixture
def other(tmp_path: Path) -> Iterator[Process]:
    """Another process, which has taken its turn."""
    with Process([sys.executable, "-c", HOLD, tmp_path / "turns"], {**os.environ, "PYTHONPATH": str(ROOT)}) as process:
        until(lambda: "taken" in process.output(), "the other process has taken its turn")
        yield process


def test_the_first_file_starts_on_a_busy_machine(own: Turns, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[float] = []
    monkeypatch.setattr(turns, "ready", lambda: measured.append(1000.0) or 1000.0)
    own.take()
    own.end()
    own.take()
    assert measured == []


@pytest.mark.parametrize("killed", [False, True])
def test_another_file_waits_until_the_processors_keep_up_or_no_file_runs(
    own: Turns, other: Process, killed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured, load = threading.Semaphore(0), [1000.0]

    def measure() -> float:
        measured.release()
        return load[0]

    monkeypatch.setattr(turns, "ready", measure)
    taker = threading.Thread(target=own.take)
    taker.start()
    for _ in range(3):
        assert measured.acquire(timeout=60)
    assert taker.is_alive()
    if killed:
        other.popen.kill()
    else:
        load[0] = READY
    taker.join(60)
    assert not taker.is_alive()


def test_ready_threads_are_counted() -> None:
    with Process([sys.executable, "-c", "while True: pass"]):
        until(lambda: ready() >= 0.5, "the program is ready to run all the time")


def test_the_processes_of_a_run_take_turns_on_a_busy_machine(tmp_path: Path) -> None:
    """The processes wait for each other, and no time limit of a test runs meanwhile."""
    (tmp_path / "pytest.ini").write_text("[pytest]\ntimeout = 60")
    (tmp_path / "conftest.py").write_text(CONFTEST)
    for number in range(3):
        (tmp_path / f"test_{number}.py").write_text(FILE)
    run = run_tests(tmp_path, "--dist", "loadfile", "-n", "3")
    assert "9 passed" in run.stdout, run.stdout + run.stderr
    files = (tmp_path / "log").read_text().splitlines()
    assert sorted(files) == sorted(6 * [f"test_{number}.py" for number in range(3)])
    assert all(len(set(files[start : start + 6])) == 1 for start in (0, 6, 12)), files
    assert set((tmp_path / "timers").read_text().split()) == {"0.0"}
    assert list(tmp_path.glob("**/turns/*")) == []


def test_a_run_without_the_cache_takes_no_turns(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\ntimeout = 60")
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_0.py").write_text(FILE)
    run = run_tests(tmp_path, "--dist", "loadfile", "-n", "2", "-p", "no:cacheprovider")
    assert "3 passed" in run.stdout, run.stdout + run.stderr
    assert not (tmp_path / "timers").exists()

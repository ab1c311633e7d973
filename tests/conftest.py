"""Fail the run if tests leave processes or threads running, and start the files with the most programs first."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import threading
import time
import uuid
from collections.abc import Generator
from pathlib import Path
from typing import Any

import hypothesis
import psutil
import pytest

from tests.support import forks, missing, release, tiers, time_limit, turns
from tests.support.process import outputs

_REAL = (
    "demo", "interop", "daemon", "contract", "benchmarks", "adapters", "faults", "interfaces", "examples", "hub", "cli",
    "navigation",
)  # fmt: skip
"""Folders with files that start many programs and take up to a minute: they run first."""

_LONG = len(_REAL) + 1
"""Position of the files with `long` tests, at the end of the list: the processes that begin there start with them."""

_LEFTOVERS = 10
"""Exit code of a run with leftovers, after which no test is repeated; see scripts/unsteady.py."""

_LEFT = "LEFT BEHIND"
_MARK = "MIDSPAN_TEST_RUN"
_run = uuid.uuid4().hex
_started_by: dict[object, str] = {}
_failed: set[str] = set()
_at_start: set[object] = set()
_left_by_workers: list[str] = []


def _processes() -> dict[object, str]:
    """Return the processes that this run started, including orphans of its children."""
    processes: dict[object, str] = {}
    current = psutil.Process()
    for process in [*current.children(recursive=True), *psutil.process_iter()]:
        with contextlib.suppress(psutil.Error, OSError):
            if process.pid == current.pid or process.status() == psutil.STATUS_ZOMBIE:
                continue
            if process in processes or process.environ().get(_MARK) == _run:
                name = forks.command_of(process.pid) or " ".join(process.cmdline())
                processes[process] = f"process {process.pid}: {name[:200]}"
    return processes


def _threads() -> dict[object, str]:
    # without the dummy threads that stand for zenoh's, which belong to the process and not to a session
    real = [t for t in threading.enumerate() if not isinstance(t, threading._DummyThread)]
    return {t: f"thread {t.name}" for t in real if t is not threading.main_thread() and t not in _at_start}


def pytest_configure(config: pytest.Config) -> None:
    # a plugin, because pytest does not call this file's hooks for a folder whose own conftest cannot be imported
    config.pluginmanager.register(missing)
    config.pluginmanager.register(time_limit)
    config.pluginmanager.register(release)
    turns.pytest_configure(config)
    # no time limits per example or for their generation: the machine may be busy
    hypothesis.settings.register_profile(
        "midspan", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
    )
    few = hypothesis.settings.get_profile("midspan")
    hypothesis.settings.register_profile("few", few, max_examples=10)
    hypothesis.settings.load_profile(config.getoption("--hypothesis-profile", None) or "midspan")


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """Stop the garbage collector: the objects that the collection of tests creates last for the whole run."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Exempt the collected tests from garbage collection from now on."""
    gc.enable()
    gc.freeze()


def pytest_sessionstart(session: pytest.Session) -> None:
    cache = getattr(session.config, "cache", None)
    if cache is not None and not hasattr(session.config, "workerinput"):
        cache.set("midspan/seed", session.config.getoption("randomly_seed", None))  # for scripts/unsteady.py
    os.environ[_MARK] = _run
    _at_start.update(_threads())
    # background jobs of a shell ignore Ctrl-C, and nohup's SIGHUP; every program of a test would inherit that
    signal.signal(signal.SIGINT, signal.default_int_handler)
    hangup = getattr(signal, "SIGHUP", None)
    if hangup is not None and signal.getsignal(hangup) is signal.SIG_IGN:
        signal.signal(hangup, signal.SIG_DFL)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--fast", action="store_true", help="only files that start no program and use no middleware")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave files out before the import, which takes longer than their tests."""
    test = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    return True if test and config.getoption("fast") and not tiers.is_fast(collection_path) else None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order the files: those that start many programs, the others, those with long tests; otherwise at random."""
    places = {name: place for place, name in enumerate(_REAL)}
    root = Path(__file__).parent
    long = {item.path for item in items if item.get_closest_marker("long")}

    def place(item: pytest.Item) -> int:
        return _LONG if item.path in long else places.get(item.path.relative_to(root).parts[0], len(_REAL))

    items.sort(key=place)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Run tests marked `alone` last, in the same run, and the other files from both ends of the list."""
    from tests.support.scheduler import Scheduler

    return Scheduler(config, log)


def pytest_runtest_logfinish(nodeid: str) -> None:
    """Remember the test after which a thread first appears; listing processes after each test would be too slow."""
    for thread in _threads():
        _started_by.setdefault(thread, nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Show what each running program of a failed test wrote."""
    report = yield
    if report.failed and report.when != "teardown":
        report.sections.extend(outputs())
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Remember failed tests: they may skip their clean-up, and fail the run anyway."""
    if report.failed:
        _failed.add(report.nodeid)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the tables that tests recorded (``record_property("table", text)``)."""
    for report in terminalreporter.getreports("passed") + terminalreporter.getreports("failed"):
        for name, text in report.user_properties if report.when == "call" else ():
            if name == "table":
                terminalreporter.write_line(str(text))


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: object, error: object) -> None:
    """Collect the leftovers that an ended pytest-xdist process reports."""
    _left_by_workers.extend(getattr(node, "workeroutput", {}).get("left", []))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    forks.close()
    leads = session.config.getoption("numprocesses", None) and not hasattr(session.config, "workerinput")
    remaining_threads = dict if leads else _threads  # with xdist, no test ran here, and the threads are xdist's
    end = time.monotonic() + 20  # on a busy machine a process may take long to exit
    while (left := {**_processes(), **remaining_threads()}) and time.monotonic() < end:
        time.sleep(0.05)
    leftovers = []
    for thing, name in left.items():
        test = _started_by.get(thing, "an unknown test")
        leftovers.append(f"{'left by what failed' if test in _failed else _LEFT}: {name} (first seen after {test})")
    for thing in left:
        if isinstance(thing, psutil.Process):
            with contextlib.suppress(psutil.Error):
                thing.kill()
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left"] = leftovers
        return
    leftovers += _left_by_workers
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    for line in leftovers:
        if reporter is not None:
            reporter.ensure_newline()
            reporter.write_line(line)
    if any(line.startswith(_LEFT) for line in leftovers):
        session.exitstatus = _LEFTOVERS

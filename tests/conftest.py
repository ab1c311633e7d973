"""A run fails when a test leaves a process or a thread behind; what starts many programs begins first, two at once."""

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

from tests.support import forks, missing, tiers
from tests.support.process import outputs

_REAL = (
    "demo", "interop", "daemon", "contract", "benchmarks", "adapters", "faults", "interfaces", "examples", "hub", "cli",
    "navigation",
)  # fmt: skip
"""Folders with files that start many programs and take up to a minute: they come first."""

_LAST = "test_first_run.py"
"""A file that takes minutes: it begins first, by the process that takes files from the end on."""

_LEFT_BEHIND = 10
"""Exit code of such a run, for which no test is run again; see scripts/unsteady.py."""

_LEFT = "LEFT BEHIND"
_MARK = "MIDSPAN_TEST_RUN"
_run = uuid.uuid4().hex
_started_by: dict[object, str] = {}
_failed: set[str] = set()
_at_start: set[object] = set()
_left_by_workers: list[str] = []


def _processes() -> dict[object, str]:
    """Processes that this run started, its children's orphans among them."""
    found: dict[object, str] = {}
    own = psutil.Process()
    for process in [*own.children(recursive=True), *psutil.process_iter()]:
        with contextlib.suppress(psutil.Error, OSError):
            if process.pid == own.pid or process.status() == psutil.STATUS_ZOMBIE:
                continue
            if process in found or own in process.parents() or process.environ().get(_MARK) == _run:
                name = forks.name_of(process.pid) or " ".join(process.cmdline())
                found[process] = f"process {process.pid}: {name[:200]}"
    return found


def _threads() -> dict[object, str]:
    # Python's stand-ins for threads of zenoh's, which belong to the process and not to a session
    real = [t for t in threading.enumerate() if not isinstance(t, threading._DummyThread)]
    return {t: f"thread {t.name}" for t in real if t is not threading.main_thread() and t not in _at_start}


def pytest_configure(config: pytest.Config) -> None:
    # as a plugin: pytest asks this file's hooks nothing of a folder whose own conftest cannot be imported
    config.pluginmanager.register(missing)
    # an example has no limit in seconds: the machine may be busy
    hypothesis.settings.register_profile("midspan", deadline=None)
    hypothesis.settings.load_profile("midspan")


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """What is made as tests are collected stays: Python need not look through it again and again."""
    gc.disable()


def pytest_collection_finish() -> None:
    """The same from now on."""
    gc.enable()
    gc.freeze()


def pytest_sessionstart(session: pytest.Session) -> None:
    cache = getattr(session.config, "cache", None)
    if cache is not None and not hasattr(session.config, "workerinput"):
        cache.set("midspan/seed", session.config.getoption("randomly_seed", None))  # for scripts/unsteady.py
    os.environ[_MARK] = _run
    _at_start.update(_threads())
    # a shell that runs this in the background lets it ignore Ctrl-C, and so would every program that a test starts
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--fast", action="store_true", help="only files that start no program and join no middleware")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave files out before they are imported, which takes longer than to run them."""
    test = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    return True if test and config.getoption("fast") and not tiers.is_fast(collection_path) else None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put files that start many programs first; otherwise the order stays random."""
    places = {name: place for place, name in enumerate(_REAL)}
    root = Path(__file__).parent

    def place(item: pytest.Item) -> int:
        last = item.path.name == _LAST
        return len(_REAL) + 1 if last else places.get(item.path.relative_to(root).parts[0], len(_REAL))

    items.sort(key=place)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Tests of the marker `alone` come last, in the same run; the other files are taken from both ends."""
    from tests.support.scheduler import Scheduler

    return Scheduler(config, log)


def pytest_runtest_logfinish(nodeid: str) -> None:
    """Remember which test a thread showed up in; processes are too costly to list after each test."""
    for thing in _threads():
        _started_by.setdefault(thing, nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Show what each running program of a failed test wrote."""
    report = yield
    if report.failed and report.when != "teardown":
        report.sections.extend(outputs())
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Remember what failed: a failed test may not get to its clean-up, and is red already."""
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
    """A process of pytest-xdist that ran some of the tests has ended: take what it found."""
    _left_by_workers.extend(getattr(node, "workeroutput", {}).get("left", []))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    forks.close()
    leads = session.config.getoption("numprocesses", None) and not hasattr(session.config, "workerinput")
    look = dict if leads else _threads  # the tests ran elsewhere; xdist has threads of its own here
    end = time.monotonic() + 20  # what is about to end does so late on a busy machine
    while (left := {**_processes(), **look()}) and time.monotonic() < end:
        time.sleep(0.05)
    found = []
    for thing, name in left.items():
        test = _started_by.get(thing, "an unknown test")
        found.append(f"{'left by what failed' if test in _failed else _LEFT}: {name} (first seen after {test})")
    for thing in left:
        if isinstance(thing, psutil.Process):
            with contextlib.suppress(psutil.Error):
                thing.kill()
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left"] = found
        return
    found += _left_by_workers
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    for line in found:
        if reporter is not None:
            reporter.ensure_newline()
            reporter.write_line(line)
    if any(line.startswith(_LEFT) for line in found):
        session.exitstatus = _LEFT_BEHIND

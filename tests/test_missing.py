"""What a machine lacks is reported once; in CI it is a failure."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.interfaces.definition import BuildError
from tests.support import missing
from tests.support.missing import COMPILER, CYCLONE, DART, ROS1, ROS2, need


@pytest.fixture(autouse=True)
def no_ci(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CI", raising=False)


def report(outcome: Any, longrepr: Any, name: str = "tests/a.py::test_b") -> Any:
    return pytest.TestReport(name, ("tests/a.py", 1, "test_b"), {}, outcome, longrepr, "call")


def no_module(name: str) -> ModuleNotFoundError:
    return ModuleNotFoundError(f"No module named {name!r}", name=name)


def test_a_test_that_needs_a_missing_part_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(missing, "lacking", lambda: {ROS1})
    need(ROS2)
    with pytest.raises(pytest.skip.Exception, match="ROS 1"):
        need(ROS1)


def test_a_failed_import_of_a_missing_part_is_a_skip() -> None:
    failed = report("failed", "a traceback")
    assert missing.judge(failed, no_module("rclpy.node")) == ROS2
    assert failed.skipped
    assert failed.longrepr[2] == f"Skipped: {ROS2}"


def test_a_missing_part_is_found_in_the_causes_of_an_error() -> None:
    error = RuntimeError()
    error.__cause__ = ImportError()
    error.__cause__.__cause__ = no_module("dartpy")
    assert missing.cause(error) == DART


def test_a_build_error_without_a_compiler_is_a_skip(monkeypatch: pytest.MonkeyPatch) -> None:
    error = BuildError("no compiler: 'g++' is not on the PATH", cure="")
    monkeypatch.setattr(missing, "lacking", frozenset)
    assert not missing.cause(error)
    monkeypatch.setattr(missing, "lacking", lambda: {COMPILER})
    assert missing.cause(error) == COMPILER


@pytest.mark.parametrize("error", [no_module("bridge.hub.sesion"), AssertionError("1 == 2"), None])
def test_other_errors_stay_failures(error: BaseException | None) -> None:
    failed = report("failed", "a traceback")
    assert not missing.judge(failed, error)
    assert failed.failed
    assert failed.longrepr == "a traceback"


@pytest.mark.parametrize("error", [None, no_module("rclpy")])
def test_a_missing_part_is_a_failure_in_ci(monkeypatch: pytest.MonkeyPatch, error: BaseException | None) -> None:
    monkeypatch.setenv("CI", "true")
    skipped = report("skipped", ("tests/a.py", 1, f"Skipped: {ROS2}")) if error is None else report("failed", "a text")
    assert missing.judge(skipped, error) == ROS2
    assert skipped.failed
    assert ROS2 in str(skipped.longrepr)


def test_missing_wheel_of_cyclone_dds_fails_in_ci(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests do not import it; only a program that they start needs it, so `need` reports it."""
    monkeypatch.setenv("CI", "true")
    monkeypatch.setattr(missing, "find_spec", lambda name: None if name == "cyclonedds" else object())
    missing.lacking.cache_clear()
    try:
        with pytest.raises(pytest.skip.Exception, match="Cyclone DDS") as skipped:
            need(CYCLONE)
    finally:
        missing.lacking.cache_clear()
    failed = report("skipped", ("tests/a.py", 1, f"Skipped: {skipped.value}"))
    assert missing.judge(failed, None) == CYCLONE
    assert failed.failed


def test_other_skips_stay_skips_in_ci(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", "true")
    skipped = report("skipped", ("tests/a.py", 1, "Skipped: only root can"))
    assert not missing.judge(skipped, None)
    assert skipped.skipped


def test_the_summary_groups_tests_by_missing_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(missing, "_not_read", {ROS1: ["tests/b.py"], ROS2: ["tests/d.py", "tests/c"]})
    lines = missing.summary([f"Skipped: {ROS1}"] * 3 + ["Skipped: only root can"])
    assert [line[:5] for line in lines] == ["ROS 1", "ROS 2"]
    assert lines[0].endswith(": 3 tests and all in tests/b.py not run")
    assert lines[1].endswith(": all in tests/c, tests/d.py not run")

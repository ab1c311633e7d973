"""The log and the status of errors that a module's callbacks raise."""

from __future__ import annotations

import logging

import pytest

from bridge.modules import step_failures
from bridge.modules.step_failures import StepFailures


def fail(text: str) -> ValueError:
    """Raise an error at this line, and return it."""
    with pytest.raises(ValueError, match=text) as raised:
        raise ValueError(text)
    return raised.value


def test_repeated_errors_of_a_line_are_logged_once_and_the_last_is_shown(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures = StepFailures("echo")
    reported: list[BaseException] = []
    failures.on_failure = reported.append
    assert failures.warning() == ""

    def logged() -> list[str]:
        """Return the messages about this module."""
        return [text for text in caplog.messages if text.startswith("echo: ")]

    with caplog.at_level(logging.ERROR):
        for number in range(5):
            failures.add(fail(f"at {number} s"))
        assert logged() == ["echo: one step failed"]
        failures.add(TypeError("another"))
        assert len(logged()) == 2
    assert len(reported) == 6
    assert failures.warning() == "one step failed: TypeError: another; the log has the traceback"
    monkeypatch.setattr(step_failures, "_SHOWN", -1.0)
    assert failures.warning() == ""


def test_an_error_in_the_handling_of_an_error_is_shown() -> None:
    failures = StepFailures("echo")

    def handle(_error: BaseException) -> None:
        raise fail("again")

    failures.on_failure = handle
    failures.add(fail("once"))
    assert failures.warning().startswith("the handling of an error failed: ValueError: again (test_step_failures.py, ")

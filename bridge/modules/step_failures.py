"""The errors that the callbacks of a module's thread raise: logged, shown in the status, and reported to the module."""

from __future__ import annotations

import logging
import time
import traceback
from collections.abc import Callable
from pathlib import PurePath

_log = logging.getLogger(__name__)

_SHOWN = 600.0
"""Seconds for which the status shows the last error."""

_SILENCE = 60.0
"""Seconds before an error of the same type and line is logged again: a timer may fail many times per second."""


class StepFailures:
    """The errors of one thread. Used on that thread, except for `warning`.

    Attributes:
        on_failure: called with each error, after it was logged.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self.on_failure: Callable[[BaseException], object] = lambda _error: None
        self._last: tuple[str, float] | None = None
        self._logged: tuple[str, float] | None = None

    def add(self, error: BaseException, what: str = "one step") -> None:
        """Log and report an error that a callback, or another kind of job, raised."""
        self._note(error, what)
        try:
            self.on_failure(error)
        except Exception as err:
            self._note(err, "the handling of an error")

    def warning(self) -> str:
        """Return the last error and the line that raised it, "" if there was none recently; on any thread."""
        last = self._last
        if last is None or time.monotonic() - last[1] > _SHOWN:
            return ""
        return f"{last[0]}; the log has the traceback"

    def _note(self, error: BaseException, what: str) -> None:
        now, source = time.monotonic(), type(error).__name__ + _place(error)
        self._last = f"{what} failed: {described(error)}", now
        if self._logged is None or self._logged[0] != source or now - self._logged[1] > _SILENCE:
            self._logged = source, now
            _log.error("%s: %s failed", self._name, what, exc_info=error)


def described(error: BaseException) -> str:
    """Return an error with the file and the line that raised it."""
    return f"{type(error).__name__}: {error}{_place(error)}"


def _place(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__, -1)
    return f" ({PurePath(frames[0].filename).name}, line {frames[0].lineno})" if frames else ""

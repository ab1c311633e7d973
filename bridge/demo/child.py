"""Processes of the demo: in groups of their own, with their words kept, and ended when their input ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bridge.demo import guard

_LAST_WORDS = 1500


class Child:
    """One process.

    Attributes:
        name: for people.
        report: the last report of a program that speaks `bridge.demo.report`; {} before the first one.
    """

    def __init__(self, name: str, command: Sequence[str | Path], env: Mapping[str, str], folder: Path) -> None:
        self.name = name
        self.report: dict[str, Any] = {}
        self._events: dict[str, dict[str, Any]] = {}
        self._changed = threading.Condition()
        self._log = folder / f"{name.replace(' ', '-')}.log"
        with self._log.open("wb") as log:
            self._popen = subprocess.Popen(
                [str(part) for part in command],
                env=dict(env),
                cwd=folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=True,
            )
        self._reader = threading.Thread(target=self._read, name=f"{name}'s words", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._popen.pid

    @property
    def running(self) -> bool:
        """Whether the process lives."""
        return self._popen.poll() is None

    def last_words(self) -> str:
        """The end of what it wrote to its error output, and its exit code where it ended."""
        words = self._log.read_text(errors="replace").strip()[-_LAST_WORDS:] if self._log.exists() else ""
        code = self._popen.poll()
        return words if code is None else f"{words}\n(exit code {code})".strip()

    def ask(self, do: str, **params: Any) -> None:
        """Send a command; a dead program is not an error here, the checks tell."""
        line = json.dumps({"do": do, **params}) + "\n"
        assert self._popen.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self._popen.stdin.write(line.encode())
            self._popen.stdin.flush()

    def wait_for(self, event: str, seconds: float) -> dict[str, Any] | None:
        """An event with this name, told already or in time; each is given once. None where the process ended or not."""
        end = time.monotonic() + seconds
        with self._changed:
            while event not in self._events:
                left = end - time.monotonic()
                if left <= 0 or not self._reader.is_alive():
                    return None
                self._changed.wait(min(left, 0.2))
            return self._events.pop(event)

    def begin_stop(self) -> None:
        """Ask it to end, by the end of its input."""
        with contextlib.suppress(OSError):
            if self._popen.stdin is not None:
                self._popen.stdin.close()

    def finish_stop(self, seconds: float) -> None:
        """Wait for the end; SIGTERM, then SIGKILL to its whole group after ``seconds``."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            try:
                self._popen.wait(seconds)
                break
            except subprocess.TimeoutExpired:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self._popen.pid, number)
        self._popen.wait()
        self._reader.join(1.0)

    def _read(self) -> None:
        assert self._popen.stdout is not None
        with self._popen.stdout as lines:
            for line in lines:
                try:
                    told = json.loads(line)
                    event = str(told.pop("event"))
                except (ValueError, KeyError, AttributeError, TypeError):
                    continue
                with self._changed:
                    if event == "report":
                        self.report = told
                    else:
                        self._events[event] = told
                    self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()


def guarded(*command: str | Path) -> list[str | Path]:
    """A command that knows nothing of its input, made to end with it."""
    return [sys.executable, "-I", Path(guard.__file__), *command]

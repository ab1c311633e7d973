"""The demo's processes, in their own process groups and with recorded output; each exits when its input ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from typing_extensions import override

from bridge.demo import guard

_MOST_TEXT = 1500
_KEPT_LINES = 400


class DemoProcess:
    """A process that exits when its standard input ends."""

    def __init__(self, command: Sequence[str | Path], env: Mapping[str, str], folder: Path, errors: Any) -> None:
        self._popen = subprocess.Popen(
            [str(part) for part in command],
            env=dict(env),
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, name="a process's output", daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """The process id, or that of the guard if the process has one."""
        return self._popen.pid

    @property
    def code(self) -> int | None:
        """The exit code; None while the process runs."""
        code = self._popen.poll()
        if code is not None:
            self._reader.join(1.0)
        return code

    @property
    def running(self) -> bool:
        return self._popen.poll() is None

    def begin_stop(self) -> None:
        """Request the end of the process by closing its input."""
        assert self._popen.stdin is not None
        with contextlib.suppress(OSError):
            self._popen.stdin.close()

    def finish_stop(self, seconds: float) -> None:
        """Wait for the process to end; after ``seconds`` send SIGTERM, then SIGKILL, to the whole group."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            try:
                self._popen.wait(seconds)
                break
            except subprocess.TimeoutExpired:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self._popen.pid, number)
        self.close()

    def close(self) -> None:
        """Read the remaining output of the ended process."""
        self._popen.wait()
        self._reader.join(1.0)

    def _read(self) -> None:
        assert self._popen.stdout is not None
        with self._popen.stdout as lines:
            self._on_output(lines)

    def _on_output(self, lines: Iterable[bytes]) -> None:
        raise NotImplementedError


class DemoChild(DemoProcess):
    """A process that may report with `bridge.demo.topics_demo.report`; ``report`` is the last report."""

    def __init__(self, name: str, command: Sequence[str | Path], env: Mapping[str, str], folder: Path) -> None:
        self.name = name
        self.report: dict[str, Any] = {}
        self._events: dict[str, dict[str, Any]] = {}
        self._changed = threading.Condition()
        self._log = folder / f"{name.replace(' ', '-')}.log"
        with self._log.open("wb") as log:
            super().__init__(command, env, folder, log)

    def last_output(self) -> str:
        """Return the last complete lines of the process's error output, and its exit code if it has ended."""
        text = self._log.read_text(encoding="utf-8", errors="replace").strip() if self._log.exists() else ""
        if len(text) > _MOST_TEXT:
            text = text[-_MOST_TEXT:]
            text = text.partition("\n")[2] or text  # a line truncated differently each time would count as progress
        code = self._popen.poll()
        return text if code is None else f"{text}\n(exit code {code})".strip()

    def ask(self, do: str, **params: Any) -> None:
        """Send a command; a dead program is not an error here, because the checks detect it."""
        assert self._popen.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self._popen.stdin.write(json.dumps({"do": do, **params}).encode() + b"\n")
            self._popen.stdin.flush()

    def wait_for(self, event: str, seconds: float) -> dict[str, Any] | None:
        """Return the last event of this name, once; None if none arrives in time, or the process has ended."""
        end = time.monotonic() + seconds
        with self._changed:
            while event not in self._events:
                left = end - time.monotonic()
                if left <= 0 or not self._reader.is_alive():
                    return None
                self._changed.wait(min(left, 0.2))
            return self._events.pop(event)

    def has_event(self, event: str) -> bool:
        """Return whether there is an event of this name that `wait_for` has not returned."""
        with self._changed:
            return event in self._events

    @override
    def _on_output(self, lines: Iterable[bytes]) -> None:
        for line in lines:
            try:
                values = json.loads(line)
                event = str(values.pop("event"))
            except (ValueError, KeyError, AttributeError, TypeError):
                continue
            with self._changed:
                if event == "report":
                    self.report = values
                else:
                    self._events[event] = values
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()


class Program(DemoProcess):
    """A guarded process that prints for people; ``lines`` are its last lines, errors included."""

    def __init__(self, command: Sequence[str | Path], env: Mapping[str, str], folder: Path) -> None:
        self.lines: deque[str] = deque(maxlen=_KEPT_LINES)
        super().__init__(guarded(*command), env, folder, subprocess.STDOUT)

    @override
    def _on_output(self, lines: Iterable[bytes]) -> None:
        self.lines.extend(line.decode(errors="replace").rstrip() for line in lines)


def guarded(*command: str | Path) -> list[str | Path]:
    """Return a command that does not read its input, wrapped in a guard so that it ends when the input ends."""
    return [sys.executable, "-I", Path(guard.__file__), *command]

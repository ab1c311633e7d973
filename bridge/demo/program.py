"""A program of the demo that speaks to people: its lines are kept as they come."""

from __future__ import annotations

import signal
import subprocess
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

from bridge.demo.child import guarded

_KEPT = 400


class Program:
    """One process, in a group of its own, which ends with the demo.

    Attributes:
        lines: what it printed lately, errors among it.
    """

    def __init__(self, command: Sequence[str | Path], env: Mapping[str, str], folder: Path) -> None:
        self.lines: deque[str] = deque(maxlen=_KEPT)
        self._popen = subprocess.Popen(
            [str(part) for part in guarded(*command)],
            env=dict(env),
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, name="a program's words", daemon=True)
        self._reader.start()

    @property
    def code(self) -> int | None:
        """Its exit code; None while it runs."""
        code = self._popen.poll()
        if code is not None:
            self._reader.join(1.0)
        return code

    def stop(self, seconds: float = 4.0) -> None:
        """End it: SIGTERM, then SIGKILL."""
        assert self._popen.stdin is not None
        self._popen.stdin.close()
        for number in (signal.SIGTERM, signal.SIGKILL):
            if self._popen.poll() is not None:
                break
            self._popen.send_signal(number)
            try:
                self._popen.wait(seconds)
            except subprocess.TimeoutExpired:
                continue
        self._reader.join(1.0)

    def _read(self) -> None:
        assert self._popen.stdout is not None
        with self._popen.stdout as lines:
            for line in lines:
                self.lines.append(line.rstrip())

"""Starts one worker as the daemon does, and measures the time until its first heartbeat and until it runs."""

from __future__ import annotations

import subprocess
import threading
import time
from types import TracebackType
from typing import Self

from benchmarks.footprints.measured import cpu_seconds
from bridge.config.model import Config
from bridge.daemon.protocol import Beat, NewConfig, Stop, decode_report, encode_command
from bridge.daemon.workers import supervised_command, worker_kinds

UP_SECONDS = 60.0


class StartedWorker:
    """A worker's process.

    Args:
        name: the worker's name.
        config: its configuration.
        environ: the daemon's environment.

    Attributes:
        first: seconds until its first heartbeat.
        running: seconds until it reported that it runs.
        cpu: processor time until it reported that it runs, seconds.
    """

    def __init__(self, name: str, config: Config, environ: dict[str, str]) -> None:
        self.first = self.running = self.cpu = 0.0
        self._name = name
        self._runs = threading.Event()
        self._last = ""
        self._began = time.monotonic()
        self._popen = subprocess.Popen(
            supervised_command(name),
            env=worker_kinds()[name].child_environment(config, environ),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self._send(encode_command(NewConfig(config)))
        self._reader = threading.Thread(target=self._read, name=f"{name}'s reports", daemon=True)
        self._reader.start()

    def wait(self) -> None:
        """Wait until the worker runs; raises `RuntimeError` if it does not in time."""
        if not self._runs.wait(UP_SECONDS):
            msg = f"{self._name} does not run after {UP_SECONDS:g} s: {self._last}"
            raise RuntimeError(msg)

    def _read(self) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            report = decode_report(line)
            if not isinstance(report, Beat):
                continue
            passed = time.monotonic() - self._began
            self._last = line.decode().strip()
            self.first = self.first or passed
            if report.health.state == "running" and not self._runs.is_set():
                self.running, self.cpu = passed, cpu_seconds(self._popen.pid)
                self._runs.set()

    def _send(self, line: bytes) -> None:
        assert self._popen.stdin is not None
        self._popen.stdin.write(line)
        self._popen.stdin.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        try:
            self._send(encode_command(Stop()))
            self._popen.wait(5.0)
        except (OSError, subprocess.TimeoutExpired):
            self._popen.kill()
        self._popen.wait()
        self._reader.join(2.0)
        for pipe in (self._popen.stdin, self._popen.stdout):
            if pipe is not None:
                pipe.close()

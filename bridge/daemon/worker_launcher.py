"""Starts a worker's process when it has the lock and no other worker must start first, or adopts a running one."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import NamedTuple

import psutil

from bridge import state_file
from bridge.config.model import Config
from bridge.daemon import processes, protocol
from bridge.daemon.lock import Lock
from bridge.daemon.worker_channel import ChannelListener, PipeChannel, SocketChannel, WorkerChannel
from bridge.daemon.worker_run import Timing
from bridge.daemon.worker_states import WorkerEvent
from bridge.daemon.workers import WorkerKind
from yarp_compat.selector_loop import SelectorLoop

logger = logging.getLogger("midspan.daemon")


class Launch(NamedTuple):
    """The result of an attempt to start a worker: a channel, or a reason and the pause before the next attempt."""

    event: WorkerEvent
    text: str = ""
    pause: float = 0.0
    channel: WorkerChannel | None = None


class WorkerLauncher:
    """Starts the processes of one worker.

    A separate service runs a ``standing`` worker: it is adopted and never started. ``first`` returns what must
    happen before this one may start, "" if nothing must. ``listener`` receives the reports of the processes.
    """

    def __init__(
        self, loop: SelectorLoop, listener: ChannelListener, kind: WorkerKind, timing: Timing,
        *, standing: bool, first: Callable[[], str],
    ) -> None:  # fmt: skip
        self.standing = standing
        self._loop = loop
        self._listener = listener
        self._kind = kind
        self._timing = timing
        self._first = first
        self._env: dict[str, str] = {}  # of the process that was started last; empty for an adopted process
        self._blocked_since = 0.0
        self._waited_for = ""

    def launch(self, config: Config) -> Launch:
        """Adopt the worker's process or start one, if possible."""
        try:
            return self._launch(config)
        except (RuntimeError, OSError) as err:
            return Launch(WorkerEvent.CANNOT_WORK, str(err), self._timing.retry)

    def _launch(self, config: Config) -> Launch:
        if self._kind.outlives or self.standing:
            running = SocketChannel(self._loop, self._listener, self._kind, config)
            if running.adopt():
                self._env = {}
                running.send(protocol.NewConfig(config))
                return Launch(WorkerEvent.START, channel=running)
        if self.standing:
            return self._wait("waiting for its service", self._timing.service_poll)
        lock = Lock(state_file.worker_lock(config, self._kind.name))
        try:
            if not lock.try_lock():
                return self._wait_for(lock)
            if first := self._first():
                return Launch(WorkerEvent.QUEUE, f"waiting for {first}")
            self._blocked_since, self._waited_for = 0.0, ""
            return Launch(WorkerEvent.START, channel=self._spawn(config, lock))
        finally:
            lock.close()

    def _spawn(self, config: Config, lock: Lock) -> WorkerChannel:
        self._env = self._kind.child_environment(config)
        channel: WorkerChannel
        if self._kind.outlives:
            channel = SocketChannel(self._loop, self._listener, self._kind, config)
            channel.spawn(self._kind, config, self._env, lock)
        else:
            channel = PipeChannel(self._loop, self._listener, self._kind, self._env, lock)
            channel.send(protocol.NewConfig(config))
        logger.info("%s started as process %d", self._kind.name, channel.pid)
        return channel

    def changes_environment(self, config: Config) -> bool:
        """Whether a configuration requires a different environment from that of the current process."""
        try:
            return bool(self._env) and self._kind.child_environment(config) != self._env
        except RuntimeError:
            return True  # the restart logs the reason

    def _wait_for(self, lock: Lock) -> Launch:
        """Wait for an earlier daemon's worker to exit; kill it after the stop limit, if it runs on this machine."""
        now, name = time.monotonic(), self._kind.name
        holder = lock.holder()
        self._blocked_since = self._blocked_since or now
        if holder is None:
            return self._wait("waiting for its lock", self._timing.exit_poll)
        if holder.owner == "service":
            return self._wait(f"run by process {holder.pid}, not by this daemon", self._timing.service_poll)
        if holder.is_here and now - self._blocked_since > self._timing.stop:
            if _is_worker(holder.pid, name):
                logger.warning("%s: process %d of an earlier daemon does not exit; killing it", name, holder.pid)
                processes.kill(holder.pid)
            self._blocked_since = now
        return self._wait(f"waiting for process {holder.pid} of {holder.machine} to exit", self._timing.exit_poll)

    def _wait(self, text: str, pause: float) -> Launch:
        if text != self._waited_for:
            logger.info("%s: %s", self._kind.name, text)
        self._waited_for = text
        return Launch(WorkerEvent.BLOCK, text, pause)


def _is_worker(pid: int, name: str) -> bool:
    """Whether the process is a worker of that name, not another program with a reused process id."""
    try:
        arguments = psutil.Process(pid).cmdline()
    except psutil.Error:
        return False
    return "worker" in arguments and name in arguments

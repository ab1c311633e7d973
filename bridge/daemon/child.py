"""The main loop of a worker's process: starts the worker, asks it how it is, hands it commands, and stops it.

Commands come from a queue that signals, the daemon's pipe and the control socket fill; reports go to a function. So the
same loop serves a supervised worker, one that outlives its daemon, and one that runs alone.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from enum import Enum
from types import FrameType

from bridge.config.model import Config
from bridge.daemon import log
from bridge.daemon.protocol import BEAT_INTERVAL, Beat, Command, Failed, NewConfig, Reloaded, Report, Restart, Stop
from bridge.routing import room
from bridge.worker import Worker

logger = logging.getLogger("midspan.worker")

_LOOK_EACH = 4
"""Heartbeats between looks at what the process has left."""

LAST_SECONDS = 4.0
"""A worker whose daemon is gone and whose stop hangs is ended after this."""


class Outcome(Enum):
    """How a worker's run ended."""

    STOPPED = "stopped"
    CANNOT_WORK = "cannot work"
    NEEDS_RESTART = "needs a restart"


class Hangup:
    """Command from SIGHUP: load the configuration again."""


Commands = queue.SimpleQueue[Command | Hangup]
"""A `queue.SimpleQueue`: its ``put`` may be called from a signal handler."""


class Child:
    """One worker in this process.

    Args:
        worker: what runs.
        commands: what it is told.
        report: takes each report; must not block for long.
        load: loads the configuration again upon SIGHUP; None where the daemon sends it.
        end_for_restart: end the run where a reload needs a restart, instead of waiting to be stopped.
    """

    def __init__(
        self,
        worker: Worker,
        commands: Commands,
        report: Callable[[Report], None],
        *,
        load: Callable[[], Config] | None = None,
        end_for_restart: bool = False,
    ) -> None:
        self._worker = worker
        self._commands = commands
        self._report = report
        self._load = load
        self._end_for_restart = end_for_restart
        self._config = Config()
        self._beats = 0
        self._answering = True
        self._short = False

    def run(self, config: Config) -> Outcome:
        """Run until stopped. Whatever the worker raises but `RuntimeError` from its start goes through."""
        self._config = config
        try:
            return self._run()
        finally:
            self._worker.stop()

    def _run(self) -> Outcome:
        try:
            self._worker.start(self._config)
        except RuntimeError as err:
            logger.error("cannot work here: %s", err)  # noqa: TRY400  a plain reason, not a fault of the program
            self._report(Failed(str(err)))
            return Outcome.CANNOT_WORK
        due = time.monotonic()
        while True:
            wait = due - time.monotonic()
            if wait <= 0:
                self._beat()
                due = time.monotonic() + BEAT_INTERVAL
                continue
            try:
                command = self._commands.get(timeout=wait)
            except queue.Empty:
                continue
            outcome = self._obey(command)
            if outcome is not None:
                return outcome

    def _beat(self) -> None:
        try:
            health = self._worker.health()
        except TimeoutError as err:
            if self._answering:
                logger.error("the worker's loop does not answer: %s", err)  # noqa: TRY400
            self._answering = False
            return
        self._answering = True
        self._beats += 1
        if self._beats % _LOOK_EACH == 0:
            self._look_at_descriptors()
        self._report(Beat(self._beats, health))

    def _look_at_descriptors(self) -> None:
        """Log when they run short, and when they no longer do; also for a router that nobody can ask then."""
        short = room.descriptors()
        if bool(short) != self._short:
            self._short = bool(short)
            logger.warning("%s", short or "there are file descriptors again")

    def _obey(self, command: Command | Hangup) -> Outcome | None:
        match command:
            case Stop(why):
                logger.info("stopping: %s", why)
                return Outcome.STOPPED
            case NewConfig(config):
                return self._reload(config)
            case Hangup():
                return self._hangup()

    def _hangup(self) -> Outcome | None:
        if self._load is None:
            return None
        from bridge.config.problems import ConfigError

        try:
            config = self._load()
        except ConfigError as err:
            logger.error("the configuration is not taken up, the running one is kept:\n%s", err)  # noqa: TRY400
            self._report(Reloaded())
            return None
        return self._reload(config)

    def _reload(self, config: Config) -> Outcome | None:
        if config == self._config:
            self._report(Reloaded())
            return None
        log.set_level(config)
        if self._worker.reload(config):
            self._config = config
            logger.info("configuration taken up")
            self._report(Reloaded())
            return None
        self._report(Restart("the new configuration needs a restart"))
        return Outcome.NEEDS_RESTART if self._end_for_restart else None


def install_signals(commands: Commands) -> None:
    """SIGTERM and SIGINT stop, SIGHUP loads again. Call from the main thread."""

    def stop(number: int, _frame: FrameType | None) -> None:
        commands.put(Stop(signal.Signals(number).name))

    def hangup(_number: int, _frame: FrameType | None) -> None:
        commands.put(Hangup())

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, hangup)


def end_process_after(seconds: float) -> None:
    """End this process hard if it is still there by then: its daemon is gone, nobody else would."""
    timer = threading.Timer(seconds, os._exit, args=(1,))
    timer.daemon = True
    timer.start()

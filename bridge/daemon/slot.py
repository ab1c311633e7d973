"""One worker's place in the daemon: starts its process, watches its heartbeat, restarts it, and stops it."""

from __future__ import annotations

import logging
import math
import signal
import time
from dataclasses import dataclass
from enum import Enum

import psutil

from bridge.backoff import Backoff
from bridge.config.model import Config
from bridge.daemon import state
from bridge.daemon.link import Exit, Link, PipeLink, kill_group
from bridge.daemon.lock import Lock
from bridge.daemon.loop import Loop
from bridge.daemon.outliving import OutlivingLink
from bridge.daemon.protocol import (
    EXIT_CANNOT_WORK,
    Beat,
    Failed,
    Hello,
    Log,
    NewConfig,
    Reloaded,
    Report,
    Restart,
    Stop,
)
from bridge.daemon.stacks import TELL_STACKS
from bridge.daemon.workers import WorkerKind

logger = logging.getLogger("midspan.daemon")

_LAST_WORDS = 0.3
"""Seconds for a silent worker to tell where its threads stand, before it is killed."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Limits in seconds.

    Attributes:
        heartbeat: a worker that is silent for longer is killed and started again.
        start: the same until its first heartbeat: imports and compilation take their time.
        stop: from the word to stop until SIGKILL.
        retry: until one that cannot work here is tried again.
        look: between looks for a worker that a service of its own runs.
        end: between looks whether an earlier daemon's worker has ended.
    """

    heartbeat: float = 5.0
    start: float = 60.0
    stop: float = 2.8
    retry: float = 30.0
    look: float = 0.2
    end: float = 0.05


class Phase(Enum):
    """What a slot is doing."""

    OFF = "off"
    UNAVAILABLE = "not available"
    STARTING = "starting"
    UP = "running"
    PAUSED = "restarting"
    FAILED = "cannot work"
    STOPPING = "stopping"


class Slot:
    """One worker's place.

    Args:
        loop: the daemon's loop.
        kind: which worker.
        timing: limits.
        standing: a service of its own runs the worker; it is adopted, never started here.
    """

    def __init__(self, loop: Loop, kind: WorkerKind, timing: Timing, *, standing: bool = False) -> None:
        self.kind = kind
        self.phase = Phase.OFF
        self.text = ""
        self.restarts = 0
        self.reloading = False
        self._loop = loop
        self._timing = timing
        self._standing = standing
        self._backoff = Backoff()
        self._link: Link | None = None
        self._config: Config | None = None
        self._env: dict[str, str] = {}
        self._failure = ""
        self._started = 0.0
        self._beat = 0.0
        self._due = 0.0
        self._blocked_since = 0.0
        self._waited_for = ""
        self._then_start = False
        self._killed = self._asked = False

    @property
    def name(self) -> str:
        """The worker's name."""
        return self.kind.name

    @property
    def pid(self) -> int:
        """Process id, 0 where there is none."""
        return self._link.pid if self._link is not None else 0

    @property
    def idle(self) -> bool:
        """Whether no process is attached."""
        return self._link is None

    @property
    def settled(self) -> bool:
        """Whether it is as well as it can be for now: nothing is under way."""
        return self.phase in {Phase.OFF, Phase.UNAVAILABLE, Phase.UP, Phase.FAILED} and not self.reloading

    @property
    def is_service(self) -> bool:
        """Whether a service of its own runs the worker."""
        return self._standing or (self._link is not None and self._link.owner == "service")

    # -- configuration -------------------------------------------------------------------------------------------------

    def configure(self, config: Config) -> None:
        """Take up a checked configuration: start, stop, tell or restart the worker, or leave it alone."""
        old, self._config = self._config, config
        enabled = self.kind.enabled(config)
        missing = self.kind.missing(config) if enabled == "auto" else ""
        if enabled is False or missing:
            if self._link is not None:
                self.stop(missing or "switched off")
            else:
                self._rest()
            return
        if self.phase is Phase.STOPPING:
            self._then_start = True
        elif self._link is None:
            self._backoff.reset()
            self._launch()
        elif old is None or self.kind.config_part(old) != self.kind.config_part(config):
            self._tell(config)

    def _tell(self, config: Config) -> None:
        assert self._link is not None
        try:
            same = not self._env or self.kind.child_environment(config) == self._env
        except RuntimeError:
            same = False  # the start says why
        if not same:
            self._restart("its environment changes")
            return
        self.reloading = True
        self._link.send(NewConfig(config))

    def _rest(self) -> None:
        """No process, and none wanted: say why."""
        assert self._config is not None
        enabled = self.kind.enabled(self._config)
        self.text = self.kind.missing(self._config) if enabled == "auto" else ""
        self.phase = Phase.UNAVAILABLE if self.text else Phase.OFF
        if self.text:
            logger.info("%s is not available: %s", self.name, self.text)

    # -- starting ------------------------------------------------------------------------------------------------------

    def _launch(self) -> None:
        assert self._config is not None
        self.phase, self.text = Phase.STARTING, ""
        self._started = self._beat = time.monotonic()
        self._failure, self._killed, self._then_start, self.reloading = "", False, False, False
        try:
            if (self.kind.outlives or self._standing) and self._adopt(self._config):
                return
            if self._standing:
                self._wait("waits for its service", self._timing.look)
                return
            lock = Lock(state.worker_lock(self._config, self.name))
            try:
                if lock.try_lock():
                    self._blocked_since, self._waited_for = 0.0, ""
                    self._spawn(self._config, lock)
                else:
                    self._wait_for(lock)
            finally:
                lock.close()
        except (RuntimeError, OSError) as err:
            self._cannot_work(str(err))

    def _adopt(self, config: Config) -> bool:
        link = OutlivingLink(self._loop, self, self.kind, config)
        if not link.adopt():
            return False
        self._link, self._env = link, {}
        link.send(NewConfig(config))
        return True

    def _spawn(self, config: Config, lock: Lock) -> None:
        self._env = self.kind.child_environment(config)
        if self.kind.outlives:
            outliving = OutlivingLink(self._loop, self, self.kind, config)
            outliving.spawn(self.kind, config, self._env, lock)
            self._link = outliving
        else:
            self._link = PipeLink(self._loop, self, self.kind, self._env, lock)
            self._link.send(NewConfig(config))
        logger.info("%s started as process %d", self.name, self._link.pid)

    def _wait_for(self, lock: Lock) -> None:
        """An earlier daemon's worker still runs: give it the time to stop by itself, then end it."""
        now = time.monotonic()
        holder = lock.holder()
        self._blocked_since = self._blocked_since or now
        what = f"waits for the end of process {holder.pid} of {holder.machine}" if holder else "waits for its lock"
        pause = self._timing.end
        if holder is not None and holder.owner == "service":
            what, pause = f"is run by process {holder.pid}, not by this daemon", self._timing.look
        elif holder is not None and holder.is_here and now - self._blocked_since > self._timing.stop:
            if _is_worker(holder.pid, self.name):
                logger.warning("%s: process %d of an earlier daemon does not end; killed", self.name, holder.pid)
                kill_group(holder.pid, signal.SIGKILL)
            self._blocked_since = now
        self._wait(what, pause)

    def _wait(self, text: str, seconds: float) -> None:
        if text != self._waited_for:
            logger.info("%s %s", self.name, text)
        self.phase, self.text, self._waited_for = Phase.PAUSED, text, text
        self._due = time.monotonic() + seconds

    def _cannot_work(self, why: str) -> None:
        logger.error("%s cannot work: %s (tried again in %g s)", self.name, why, self._timing.retry)
        self.phase, self.text = Phase.FAILED, why
        self._due = time.monotonic() + self._timing.retry

    # -- what the worker says ------------------------------------------------------------------------------------------

    def on_report(self, report: Report) -> None:
        """The worker said something."""
        match report:
            case Beat(_, health):
                self._beat, self._asked = time.monotonic(), False
                if self.phase is Phase.STARTING:
                    self.phase = Phase.UP
                    logger.info("%s is up (%s)", self.name, health.text)
                if self.phase is Phase.UP:
                    self.text = health.text if health.state == "running" else f"{health.state}, {health.text}"
            case Log(level, text):
                logger.log(level, "%s", text, extra={"worker": self.name})
            case Reloaded():
                self.reloading = False
            case Restart(why):
                self._restart(why)
            case Failed(why):
                self._failure = why
            case Hello(pid, owner):
                logger.info("%s: connected to process %d, started by a %s", self.name, pid, owner)

    def on_gone(self, ended: Exit) -> None:
        """The worker's process has ended."""
        self._standing = self.is_service
        self._link = None
        self.reloading = False
        lived = time.monotonic() - self._started
        if self.phase is Phase.STOPPING:
            logger.info("%s %s", self.name, ended)
            self._rest()
            if self._then_start:
                self._launch()
        elif ended.code == EXIT_CANNOT_WORK:
            self._cannot_work(self._failure or "it said so by its exit code")
        else:
            self.restarts += 1
            pause = self._backoff.pause(lived)
            why = self._failure or str(ended)
            logger.error("%s %s after %.1f s; restarted in %g s", self.name, why, lived, pause)
            self.phase, self.text = Phase.PAUSED, why
            self._due = time.monotonic() + pause

    # -- time ----------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """What is due; called several times a second."""
        if self._link is not None:
            self._link.poll()
        now = time.monotonic()
        match self.phase:
            case Phase.STARTING if now - self._started > self._timing.start:
                self._kill(f"did not come up within {self._timing.start:g} s")
            case Phase.UP if now - self._beat > self._timing.heartbeat + _LAST_WORDS:
                self._kill(f"sent no heartbeat for {self._timing.heartbeat:g} s")
            case Phase.UP if now - self._beat > self._timing.heartbeat and not self._asked:
                self._asked = True
                if self._link is not None and self._link.pid and TELL_STACKS is not None:
                    self._link.kill(TELL_STACKS)
            case Phase.STOPPING if now > self._due:
                self._kill("did not stop in time")
            case Phase.PAUSED | Phase.FAILED if now > self._due:
                self._launch()

    @property
    def due(self) -> float:
        """When `tick` has something to do at the latest, on the monotonic clock; infinite where that is not known."""
        return self._due if self.phase in {Phase.PAUSED, Phase.FAILED} else math.inf

    def forgive(self, seconds: float) -> None:
        """The daemon itself did not look for so long."""
        self._beat += seconds
        self._started += seconds

    def _kill(self, why: str) -> None:
        if self._killed or self._link is None:
            return
        self._killed = True
        self._failure = why
        logger.error("%s %s: process %d is killed", self.name, why, self._link.pid)
        self.kill()

    def kill(self) -> None:
        """SIGKILL, at once."""
        if self._link is None:
            return
        if self._link.pid:
            self._link.kill(signal.SIGKILL)
        else:
            # adopted, but it never told who it is: its lock does, once this connection is given up
            self._link.detach()
            self.on_gone(Exit(None))

    # -- stopping ------------------------------------------------------------------------------------------------------

    def _restart(self, why: str) -> None:
        if self.is_service and self._link is not None:  # it does so by itself, and is then found again
            logger.info("%s starts again: %s", self.name, why)
            self.phase, self.text = Phase.STOPPING, why
            self._due = time.monotonic() + self._timing.stop
        else:
            self.stop(why)
        self._then_start = True

    def stop(self, why: str, seconds: float | None = None) -> None:
        """Tell the worker to stop; SIGKILL after ``seconds`` (by default the limit), from `tick`."""
        self._then_start = False
        if self._link is None:
            self.phase, self.text = Phase.OFF, ""
            return
        if self.phase is not Phase.STOPPING:
            logger.info("%s is stopped: %s", self.name, why)
            self.phase, self.text, self._killed = Phase.STOPPING, why, False
            self._link.send(Stop())
            self._link.kill(signal.SIGTERM)
        self._due = time.monotonic() + (self._timing.stop if seconds is None else seconds)

    def let_go(self) -> None:
        """Close the line to a worker that goes on without this daemon."""
        if self._link is not None:
            self._link.detach()
            self._link = None
        self.phase, self.text = Phase.OFF, ""


def _is_worker(pid: int, name: str) -> bool:
    """Whether the process is a worker of that name, and not some other one that got a dead worker's number."""
    try:
        arguments = psutil.Process(pid).cmdline()
    except psutil.Error:
        return False
    return "worker" in arguments and name in arguments

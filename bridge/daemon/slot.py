"""One worker's place in the daemon: starts its process, watches its heartbeat, restarts it, and stops it."""

from __future__ import annotations

import logging
import math
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

import psutil

from bridge import state_file
from bridge.concurrency import Backoff
from bridge.config.model import Config
from bridge.daemon import protocol
from bridge.daemon.begin import TELL_STACKS
from bridge.daemon.link import Exit, OutlivingLink, PipeLink, WorkerLink, kill_group
from bridge.daemon.lock import Lock
from bridge.daemon.loop import SelectorLoop
from bridge.daemon.query import Phase
from bridge.daemon.workers import WorkerKind
from bridge.progress import ENDLESS, Busy, Movement
from bridge.worker import Health

logger = logging.getLogger("midspan.daemon")

_LAST_WORDS = 0.3
"""Seconds for a silent worker to tell where its threads stand, before it is killed."""

_DOUBLED = 2
"""Times that what a worker may stand still for as it comes up is doubled."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Limits in seconds.

    Attributes:
        heartbeat: a worker that sends no heartbeat, nor computes, for longer is killed and started again.
        start: one that comes up may stand still for so long; the next one in its place for twice as long, and so on.
        patience: one that comes up and stands still for longer keeps the others waiting no more.
        stop: from the word to stop until SIGKILL.
        retry: until one that cannot work here is tried again.
        look: between looks for a worker that a service of its own runs.
        end: between looks whether an earlier daemon's worker has ended.
    """

    heartbeat: float = 5.0
    start: float = 60.0
    patience: float = 3.0
    stop: float = 2.8
    retry: float = 30.0
    look: float = 0.2
    end: float = 0.05


class Slot:
    """One worker's place.

    A ``standing`` worker is run by a service of its own: the daemon adopts it, and never starts it. ``first`` says
    which workers must come up before this one may start, "" if none. ``link`` leads to its process.
    """

    def __init__(
        self, loop: SelectorLoop, kind: WorkerKind, timing: Timing, *, standing: bool = False,
        first: Callable[[], str] = lambda: "",
    ) -> None:  # fmt: skip
        self.kind = kind
        self.phase = Phase.OFF
        self.since = time.monotonic()
        self.text = ""
        self.restarts = 0
        self.ended = ""  # how its last process ended, if the daemon did not stop it
        self.beat_at: float | None = None  # of its process, on the monotonic clock; None before the first
        self.reloading = False
        self._loop = loop
        self._timing = timing
        self._standing = standing
        self._first = first
        self._backoff = Backoff()
        self.link: WorkerLink | None = None
        self._config: Config | None = None
        self._env: dict[str, str] = {}
        self._failure = ""
        self._started = 0.0
        self._movement = Movement(0.0)
        self._stood_still = 0
        self._due = 0.0
        self._blocked_since = 0.0
        self._waited_for = ""
        self._then_start = False
        self._killed = self._asked = self._spawned = self._up = False

    def _enter(self, phase: Phase, text: str = "") -> None:
        if phase is not self.phase:
            self.phase, self.since = phase, time.monotonic()
        self.text = text

    @property
    def name(self) -> str:
        """The worker's name."""
        return self.kind.name

    @property
    def pid(self) -> int:
        """Process id, 0 where there is none."""
        return self.link.pid if self.link is not None else 0

    @property
    def idle(self) -> bool:
        """Whether no process is attached."""
        return self.link is None

    @property
    def still(self) -> float:
        """Seconds for which its process has come no further, has not computed and has sent no heartbeat."""
        return self._movement.still(time.monotonic()) if self.phase in {Phase.STARTING, Phase.UP} else 0.0

    @property
    def comes_up(self) -> bool:
        """Whether a process of this daemon's comes up, and works at that."""
        return self.phase is Phase.STARTING and self._spawned and self.still <= self._timing.patience

    @property
    def settled(self) -> bool:
        """Whether it is as well as it can be for now: nothing is under way."""
        return self.phase in {Phase.OFF, Phase.UNAVAILABLE, Phase.UP, Phase.FAILED} and not self.reloading

    @property
    def is_service(self) -> bool:
        """Whether a service of its own runs the worker."""
        return self._standing or (self.link is not None and self.link.owner == "service")

    # -- configuration -------------------------------------------------------------------------------------------------

    def configure(self, config: Config) -> None:
        """Take up a checked configuration: start, stop, tell or restart the worker, or leave it alone."""
        old, self._config = self._config, config
        enabled = self.kind.enabled(config)
        missing = self.kind.missing(config) if enabled == "auto" else ""
        if enabled is False or missing:
            if self.link is not None:
                self.stop(missing or "switched off")
            else:
                self._rest()
            return
        if self.phase is Phase.STOPPING:
            self._then_start = True
        elif self.link is None:
            self._backoff.reset()
            self._launch()
        elif old is None or self.kind.config_part(old) != self.kind.config_part(config):
            self._tell(config)

    def _tell(self, config: Config) -> None:
        assert self.link is not None
        try:
            same = not self._env or self.kind.child_environment(config) == self._env
        except RuntimeError:
            same = False  # the start says why
        if not same:
            self._restart("its environment changes")
            return
        self.reloading = True
        self.link.send(protocol.NewConfig(config))

    def _rest(self) -> None:
        """No process, and none wanted: say why."""
        assert self._config is not None
        enabled = self.kind.enabled(self._config)
        missing = self.kind.missing(self._config) if enabled == "auto" else ""
        self._enter(Phase.UNAVAILABLE if missing else Phase.OFF, missing)
        if missing:
            logger.info("%s is not available: %s", self.name, self.text)

    # -- starting ------------------------------------------------------------------------------------------------------

    def _launch(self) -> None:
        assert self._config is not None
        self._started = time.monotonic()
        self._movement = Movement(self._started)
        self.beat_at = None
        self._failure, self._then_start, self.reloading = "", False, False
        self._killed = self._asked = self._spawned = self._up = False
        try:
            if (self.kind.outlives or self._standing) and self._adopt(self._config):
                return
            if self._standing:
                self._wait("waits for its service", self._timing.look)
                return
            lock = Lock(state_file.worker_lock(self._config, self.name))
            try:
                if not lock.try_lock():
                    self._wait_for(lock)
                elif first := self._first():
                    self._enter(Phase.QUEUED, f"{first} comes up first")
                else:
                    self._blocked_since, self._waited_for = 0.0, ""
                    self._spawn(self._config, lock)
            finally:
                lock.close()
        except (RuntimeError, OSError) as err:
            self._cannot_work(str(err))

    def _adopt(self, config: Config) -> bool:
        link = OutlivingLink(self._loop, self, self.kind, config)
        if not link.adopt():
            return False
        self.link, self._env = link, {}
        self._enter(Phase.STARTING)
        link.send(protocol.NewConfig(config))
        return True

    def _spawn(self, config: Config, lock: Lock) -> None:
        self._env = self.kind.child_environment(config)
        if self.kind.outlives:
            outliving = OutlivingLink(self._loop, self, self.kind, config)
            outliving.spawn(self.kind, config, self._env, lock)
            self.link = outliving
        else:
            self.link = PipeLink(self._loop, self, self.kind, self._env, lock)
            self.link.send(protocol.NewConfig(config))
        self._enter(Phase.STARTING)
        self._spawned = True
        logger.info("%s started as process %d", self.name, self.link.pid)

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
        self._waited_for = text
        self._enter(Phase.PAUSED, text)
        self._due = time.monotonic() + seconds

    def _cannot_work(self, why: str) -> None:
        logger.error("%s cannot work: %s (tried again in %g s)", self.name, why, self._timing.retry)
        self._enter(Phase.FAILED, why)
        self._due = time.monotonic() + self._timing.retry

    # -- what the worker says ------------------------------------------------------------------------------------------

    def on_report(self, report: protocol.Report) -> None:
        """The worker said something."""
        match report:
            case Busy(text, used, read):
                self._movement.look(time.monotonic(), text, used, read)
                if self.phase is Phase.STARTING:
                    self.text = text
            case protocol.Beat(_, health):
                self.beat_at = time.monotonic()
                self._movement.move(self.beat_at)
                self._asked = False
                if self.phase in {Phase.STARTING, Phase.UP}:
                    self._take_health(health)
            case protocol.LogLine(level, text):
                logger.log(level, "%s", text, extra={"worker": self.name})
            case protocol.Reloaded():
                self.reloading = False
            case protocol.Restart(why):
                self._restart(why)
            case protocol.Failed(why):
                self._failure = why
            case protocol.Hello(pid, owner):
                logger.info("%s: connected to process %d, started by a %s", self.name, pid, owner)

    def _take_health(self, health: Health) -> None:
        """It has come up, or goes on; it is called up once it says that it runs."""
        if health.state == "running" and not self._up:
            self._up = True
            logger.info("%s is up (%s)", self.name, health.text)
        elif self.phase is Phase.STARTING:
            done = "stands by" if health.state == "standby" else "waits"
            logger.info("%s has started and %s: %s", self.name, done, health.text)
        self._stood_still = 0
        self._enter(Phase.UP, health.text if health.state == "running" else f"{health.state}, {health.text}")

    def on_gone(self, ended: Exit) -> None:
        """The worker's process has ended."""
        self._standing = self.is_service
        self.link = None
        self.reloading = False
        now = time.monotonic()
        if self.phase is Phase.STOPPING:
            logger.info("%s %s", self.name, ended)
            self._rest()
            if self._then_start:
                self._launch()
        elif ended.code == protocol.EXIT_CANNOT_WORK:
            self._cannot_work(self._failure or "it said so by its exit code")
        else:
            self.restarts += 1
            pause = self._backoff.pause(now - self.since if self.phase is Phase.UP else 0.0)
            why = self.ended = self._failure or str(ended)
            logger.error("%s %s after %.1f s; restarted in %g s", self.name, why, now - self._started, pause)
            self._enter(Phase.PAUSED, why)
            self._due = now + pause

    # -- time ----------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """What is due; called several times a second."""
        if self.link is not None:
            self.link.poll()
        now = time.monotonic()
        match self.phase:
            case Phase.STARTING | Phase.UP:
                self._judge(now)
            case Phase.QUEUED:
                self._launch()
            case Phase.STOPPING if now > self._due:
                self._kill("did not stop in time")
            case Phase.PAUSED | Phase.FAILED if now > self._due:
                self._launch()

    @property
    def _limit(self) -> float:
        """Seconds for which it may stand still now."""
        if self.phase is Phase.UP:
            return self._timing.heartbeat
        return self._timing.start * (1 << min(self._stood_still, _DOUBLED))

    def _judge(self, now: float) -> None:
        """Kill it where it hangs; one that only takes long is let be."""
        if self._killed:
            return
        limit, still, computed = self._limit, self._movement.still(now), self._movement.computed()
        if computed > ENDLESS * limit:
            self._kill(f"is in a loop without an end: {self._movement.step} has computed for {computed:.0f} s")
        elif still > limit + _LAST_WORDS:
            self._kill(self._silence(limit))
        elif still > limit and not self._asked:
            self._asked = True
            listens = self.phase is Phase.UP or self.text  # before its first word the signal would end it
            if listens and self.link is not None and self.link.pid and TELL_STACKS is not None:
                self.link.kill(TELL_STACKS)

    def _silence(self, limit: float) -> str:
        if self.phase is Phase.UP:
            return f"sent no heartbeat for {limit:g} s"
        self._stood_still += 1
        return (
            f"stood still for {limit:g} s at its start ({self.text or 'without a word'}); the next one may for"
            f" {self._limit:g} s"
        )

    @property
    def due(self) -> float:
        """When `tick` has something to do at the latest, on the monotonic clock; infinite where that is not known."""
        return self._due if self.phase in {Phase.PAUSED, Phase.FAILED} else math.inf

    def forgive(self, seconds: float) -> None:
        """The daemon itself did not look for so long."""
        self._movement.moved += seconds

    def _kill(self, why: str) -> None:
        if self._killed or self.link is None:
            return
        self._killed = True
        self._failure = why
        logger.error("%s %s: process %d is killed", self.name, why, self.link.pid)
        self.kill()

    def kill(self) -> None:
        """SIGKILL, at once."""
        if self.link is None:
            return
        if self.link.pid:
            self.link.kill(signal.SIGKILL)
        else:
            # adopted, but it never told who it is: its lock does, once this connection is given up
            self.link.detach()
            self.on_gone(Exit(None))

    # -- stopping ------------------------------------------------------------------------------------------------------

    def _restart(self, why: str) -> None:
        if self.is_service and self.link is not None:  # it does so by itself, and is then found again
            logger.info("%s starts again: %s", self.name, why)
            self._enter(Phase.STOPPING, why)
            self._due = time.monotonic() + self._timing.stop
        else:
            self.stop(why)
        self._then_start = True

    def stop(self, why: str, seconds: float | None = None) -> None:
        """Tell the worker to stop; SIGKILL after ``seconds`` (by default the limit), from `tick`."""
        self._then_start = False
        if self.link is None:
            self._enter(Phase.OFF)
            return
        if self.phase is not Phase.STOPPING:
            logger.info("%s is stopped: %s", self.name, why)
            self._killed = False
            self._enter(Phase.STOPPING, why)
            self.link.send(protocol.Stop())
            self.link.kill(signal.SIGTERM)
        self._due = time.monotonic() + (self._timing.stop if seconds is None else seconds)

    def let_go(self) -> None:
        """Close the line to a worker that goes on without this daemon."""
        if self.link is not None:
            self.link.detach()
            self.link = None
        self._enter(Phase.OFF)


def _is_worker(pid: int, name: str) -> bool:
    """Whether the process is a worker of that name, and not some other one that got a dead worker's number."""
    try:
        arguments = psutil.Process(pid).cmdline()
    except psutil.Error:
        return False
    return "worker" in arguments and name in arguments

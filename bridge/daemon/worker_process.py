"""Supervision of one worker: start, heartbeat, restart and stop of its process."""

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
from bridge.daemon.heartbeat import DUMP_STACKS
from bridge.daemon.lock import Lock
from bridge.daemon.query import Phase
from bridge.daemon.worker_channel import Exit, PipeChannel, SocketChannel, WorkerChannel, kill_group
from bridge.daemon.workers import WorkerKind
from bridge.progress import ENDLESS, Busy, Movement
from bridge.worker import Health
from yarp_compat.selector_loop import SelectorLoop

logger = logging.getLogger("midspan.daemon")

_STACK_SECONDS = 0.3
"""Seconds for a hung worker to log the stacks of its threads before SIGKILL."""

_DOUBLED = 2
"""Maximum number of times that the limit for a start without progress is doubled."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Limits in seconds.

    Attributes:
        heartbeat: a worker that neither sends a heartbeat nor computes for this time is killed and restarted.
        start: longest time without progress while starting; it doubles after each such failure, up to a limit.
        patience: a starting worker without progress for this time no longer delays the start of others.
        stop: from the stop request until SIGKILL.
        retry: pause before a worker that cannot work here is started again.
        service_poll: interval of polling for a worker that a separate service runs.
        exit_poll: interval of polling for the exit of an earlier daemon's worker.
    """

    heartbeat: float = 5.0
    start: float = 60.0
    patience: float = 3.0
    stop: float = 2.8
    retry: float = 30.0
    service_poll: float = 0.2
    exit_poll: float = 0.05


class WorkerProcess:
    """Runs and monitors one worker.

    A ``standing`` worker is run by a separate service: the daemon adopts it and never starts it. ``first`` returns the
    workers that must finish starting before this one, "" if none. ``channel`` is the connection to its process.
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
        self.ended = ""  # how its last process exited, if the daemon did not stop it
        self.beat_at: float | None = None  # last heartbeat, on the monotonic clock; None before the first
        self.reloading = False
        self._loop = loop
        self._timing = timing
        self._standing = standing
        self._first = first
        self._backoff = Backoff()
        self.channel: WorkerChannel | None = None
        self._config: Config | None = None
        self._env: dict[str, str] = {}
        self._failure = ""
        self._started = 0.0
        self._movement = Movement(0.0)
        self._stalled_starts = 0
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
        """Process id, 0 if no process is attached."""
        return self.channel.pid if self.channel is not None else 0

    @property
    def idle(self) -> bool:
        """Whether no process is attached."""
        return self.channel is None

    @property
    def still(self) -> float:
        """Seconds without progress, computation or a heartbeat of its process."""
        return self._movement.still(time.monotonic()) if self.phase in {Phase.STARTING, Phase.UP} else 0.0

    @property
    def comes_up(self) -> bool:
        """Whether this daemon's process for it is starting and makes progress."""
        return self.phase is Phase.STARTING and self._spawned and self.still <= self._timing.patience

    @property
    def settled(self) -> bool:
        """Whether it is in a stable phase and no reload is pending."""
        return self.phase in {Phase.OFF, Phase.UNAVAILABLE, Phase.UP, Phase.FAILED} and not self.reloading

    @property
    def is_service(self) -> bool:
        """Whether a separate service runs the worker."""
        return self._standing or (self.channel is not None and self.channel.owner == "service")

    # -- configuration -------------------------------------------------------------------------------------------------

    def configure(self, config: Config) -> None:
        """Apply a checked configuration: start, stop, reload or restart the worker if needed."""
        old, self._config = self._config, config
        enabled = self.kind.enabled(config)
        missing = self.kind.missing(config) if enabled == "auto" else ""
        if enabled is False or missing:
            if self.channel is not None:
                self.stop(missing or "disabled by the configuration")
            else:
                self._enter_idle()
            return
        if self.phase is Phase.STOPPING:
            self._then_start = True
        elif self.channel is None:
            self._backoff.reset()
            self._launch()
        elif old is None or self.kind.config_part(old) != self.kind.config_part(config):
            self._reconfigure(config)

    def _reconfigure(self, config: Config) -> None:
        assert self.channel is not None
        try:
            same = not self._env or self.kind.child_environment(config) == self._env
        except RuntimeError:
            same = False  # the restart logs the reason
        if not same:
            self._restart("its environment has changed")
            return
        self.reloading = True
        self.channel.send(protocol.NewConfig(config))

    def _enter_idle(self) -> None:
        """Enter the phase of a worker without a process, with the reason."""
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
                self._wait("waiting for its service", self._timing.service_poll)
                return
            lock = Lock(state_file.worker_lock(self._config, self.name))
            try:
                if not lock.try_lock():
                    self._wait_for(lock)
                elif first := self._first():
                    self._enter(Phase.QUEUED, f"waiting for {first} to start")
                else:
                    self._blocked_since, self._waited_for = 0.0, ""
                    self._spawn(self._config, lock)
            finally:
                lock.close()
        except (RuntimeError, OSError) as err:
            self._cannot_work(str(err))

    def _adopt(self, config: Config) -> bool:
        channel = SocketChannel(self._loop, self, self.kind, config)
        if not channel.adopt():
            return False
        self.channel, self._env = channel, {}
        self._enter(Phase.STARTING)
        channel.send(protocol.NewConfig(config))
        return True

    def _spawn(self, config: Config, lock: Lock) -> None:
        self._env = self.kind.child_environment(config)
        if self.kind.outlives:
            channel = SocketChannel(self._loop, self, self.kind, config)
            channel.spawn(self.kind, config, self._env, lock)
            self.channel = channel
        else:
            self.channel = PipeChannel(self._loop, self, self.kind, self._env, lock)
            self.channel.send(protocol.NewConfig(config))
        self._enter(Phase.STARTING)
        self._spawned = True
        logger.info("%s started as process %d", self.name, self.channel.pid)

    def _wait_for(self, lock: Lock) -> None:
        """Wait for an earlier daemon's worker to exit; kill it after the stop limit."""
        now = time.monotonic()
        holder = lock.holder()
        self._blocked_since = self._blocked_since or now
        process = f"process {holder.pid} of {holder.machine}" if holder else ""
        state = f"waiting for {process} to exit" if holder else "waiting for its lock"
        pause = self._timing.exit_poll
        if holder is not None and holder.owner == "service":
            state, pause = f"run by process {holder.pid}, not by this daemon", self._timing.service_poll
        elif holder is not None and holder.is_here and now - self._blocked_since > self._timing.stop:
            if _is_worker(holder.pid, self.name):
                logger.warning("%s: process %d of an earlier daemon does not exit; killing it", self.name, holder.pid)
                kill_group(holder.pid, signal.SIGKILL)
            self._blocked_since = now
        self._wait(state, pause)

    def _wait(self, text: str, seconds: float) -> None:
        if text != self._waited_for:
            logger.info("%s: %s", self.name, text)
        self._waited_for = text
        self._enter(Phase.PAUSED, text)
        self._due = time.monotonic() + seconds

    def _cannot_work(self, why: str) -> None:
        logger.error("%s cannot work: %s (retrying in %g s)", self.name, why, self._timing.retry)
        self._enter(Phase.FAILED, why)
        self._due = time.monotonic() + self._timing.retry

    # -- reports of the worker -----------------------------------------------------------------------------------------

    def on_report(self, report: protocol.Report) -> None:
        """Handle a report of the worker."""
        match report:
            case Busy(text, used, read):
                self._movement.update(time.monotonic(), text, used, read)
                if self.phase is Phase.STARTING:
                    self.text = text
            case protocol.Beat(_, health):
                self.beat_at = time.monotonic()
                self._movement.move(self.beat_at)
                self._asked = False
                if self.phase in {Phase.STARTING, Phase.UP}:
                    self._on_health(health)
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

    def _on_health(self, health: Health) -> None:
        """Handle a heartbeat; the worker is up once its health is "running"."""
        named = health.text.startswith(health.state)  # "waiting for ..."
        if (health.state == "running" and not self._up) or self.phase is Phase.STARTING:
            self._up = health.state == "running"
            logger.info("%s: %s", self.name, health.text if named else f"{health.state} ({health.text})")
        self._stalled_starts = 0
        self._enter(Phase.UP, health.text if named or health.state == "running" else f"{health.state}: {health.text}")

    def on_exit(self, ended: Exit) -> None:
        """Handle the exit of the worker's process."""
        self._standing = self.is_service
        self.channel = None
        self.reloading = False
        now = time.monotonic()
        if self.phase is Phase.STOPPING:
            logger.info("%s %s", self.name, ended)
            self._enter_idle()
            if self._then_start:
                self._launch()
        elif ended.code == protocol.EXIT_CANNOT_WORK:
            self._cannot_work(self._failure or "it reported no reason")
        else:
            self.restarts += 1
            pause = self._backoff.pause(now - self.since if self.phase is Phase.UP else 0.0)
            reason = self.ended = self._failure or str(ended)
            logger.error("%s %s after %.1f s; restarting in %g s", self.name, reason, now - self._started, pause)
            self._enter(Phase.PAUSED, reason)
            self._due = now + pause

    # -- time ----------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Check limits, and start what is due; called several times a second."""
        if self.channel is not None:
            self.channel.poll()
        now = time.monotonic()
        match self.phase:
            case Phase.STARTING | Phase.UP:
                self._check_progress(now)
            case Phase.QUEUED:
                self._launch()
            case Phase.STOPPING if now > self._due:
                self._kill("did not stop in time")
            case Phase.PAUSED | Phase.FAILED if now > self._due:
                self._launch()

    @property
    def _limit(self) -> float:
        """Longest time without progress in the current phase, in seconds."""
        if self.phase is Phase.UP:
            return self._timing.heartbeat
        return self._timing.start * (1 << min(self._stalled_starts, _DOUBLED))

    def _check_progress(self, now: float) -> None:
        """Kill a hung worker, but not one that computes for a long time."""
        if self._killed:
            return
        limit, still, computed = self._limit, self._movement.still(now), self._movement.computed()
        if computed > ENDLESS * limit:
            self._kill(f"is in an endless loop: {self._movement.step} has computed for {computed:.0f} s")
        elif still > limit + _STACK_SECONDS:
            self._kill(self._silence(limit))
        elif still > limit and not self._asked:
            self._asked = True
            handles_signal = self.phase is Phase.UP or self.text  # before its first report the signal would kill it
            if handles_signal and self.channel is not None and self.channel.pid and DUMP_STACKS is not None:
                self.channel.kill(DUMP_STACKS)

    def _silence(self, limit: float) -> str:
        if self.phase is Phase.UP:
            return f"sent no heartbeat for {limit:g} s"
        self._stalled_starts += 1
        step = self.text or "no report"
        return f"made no progress for {limit:g} s while starting ({step}); the next limit is {self._limit:g} s"

    @property
    def due(self) -> float:
        """Latest time at which `tick` has work to do, on the monotonic clock; infinite if unknown."""
        return self._due if self.phase in {Phase.PAUSED, Phase.FAILED} else math.inf

    def forgive(self, seconds: float) -> None:
        """Ignore a time, in seconds, in which the daemon itself did not run."""
        self._movement.moved += seconds

    def _kill(self, why: str) -> None:
        if self._killed or self.channel is None:
            return
        self._killed = True
        self._failure = why
        logger.error("%s %s; killing process %d", self.name, why, self.channel.pid)
        self.kill()

    def kill(self) -> None:
        """Send SIGKILL."""
        if self.channel is None:
            return
        if self.channel.pid:
            self.channel.kill(signal.SIGKILL)
        else:
            # adopted, but its process id is unknown: the lock names it once this connection is closed
            self.channel.detach()
            self.on_exit(Exit(None))

    # -- stopping ------------------------------------------------------------------------------------------------------

    def _restart(self, why: str) -> None:
        if self.is_service and self.channel is not None:  # it restarts by itself and is then adopted again
            logger.info("%s restarts: %s", self.name, why)
            self._enter(Phase.STOPPING, why)
            self._due = time.monotonic() + self._timing.stop
        else:
            self.stop(why)
        self._then_start = True

    def stop(self, why: str, seconds: float | None = None) -> None:
        """Ask the worker to stop; `tick` sends SIGKILL after ``seconds`` (by default the limit)."""
        self._then_start = False
        if self.channel is None:
            self._enter(Phase.OFF)
            return
        if self.phase is not Phase.STOPPING:
            logger.info("stopping %s: %s", self.name, why)
            self._killed = False
            self._enter(Phase.STOPPING, why)
            self.channel.send(protocol.Stop())
            self.channel.kill(signal.SIGTERM)
        self._due = time.monotonic() + (self._timing.stop if seconds is None else seconds)

    def release(self) -> None:
        """Disconnect from a worker that continues without this daemon."""
        if self.channel is not None:
            self.channel.detach()
            self.channel = None
        self._enter(Phase.OFF)


def _is_worker(pid: int, name: str) -> bool:
    """Whether the process is a worker of that name, not another program with a reused process id."""
    try:
        arguments = psutil.Process(pid).cmdline()
    except psutil.Error:
        return False
    return "worker" in arguments and name in arguments

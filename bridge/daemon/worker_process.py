"""Supervision of one worker: start, heartbeat, restart and stop of its process."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

from bridge.config.model import Config
from bridge.daemon import protocol
from bridge.daemon.worker_channel import Exit, WorkerChannel
from bridge.daemon.worker_launcher import WorkerLauncher
from bridge.daemon.worker_run import Progress, RunHistory, Timing, WorkerRun
from bridge.daemon.worker_states import Phase, WorkerEvent, WorkerState
from bridge.daemon.workers import WorkerKind
from bridge.progress import Busy
from bridge.worker import Health
from yarp_compat.selector_loop import SelectorLoop, Timer

logger = logging.getLogger("midspan.daemon")

STEP = 0.25
"""Seconds between checks of a process that starts or stops, that is late, or whose exit the system does not report."""


class WorkerProcess:
    """Runs and monitors one worker.

    A separate service runs a ``standing`` worker: the daemon adopts it and never starts it. ``first`` returns what
    must happen before this one may start, "" if nothing must.

    Attributes:
        state: the worker's state; `bridge.daemon.worker_states` defines the transitions.
        channel: the connection to the worker's process, None without one.
    """

    def __init__(
        self, loop: SelectorLoop, kind: WorkerKind, timing: Timing, *, standing: bool = False,
        first: Callable[[], str] = lambda: "",
    ) -> None:  # fmt: skip
        self.kind = kind
        self.state = WorkerState()
        self.channel: WorkerChannel | None = None
        self._loop = loop
        self._timing = timing
        self._launcher = WorkerLauncher(loop, self, kind, timing, standing=standing, first=first)
        self._run = WorkerRun()
        self._history = RunHistory()
        self._config: Config | None = None
        self._timer: Timer | None = None
        self._start_again = False  # once the process that is being stopped has exited

    @property
    def name(self) -> str:
        return self.kind.name

    @property
    def phase(self) -> Phase:
        """The phase of the worker's process."""
        return self.state.state

    @property
    def text(self) -> str:
        """The current step, the health, or the reason for the phase."""
        return self.state.text

    @property
    def since(self) -> float:
        """When the phase began, on the monotonic clock."""
        return self.state.since

    @property
    def restarts(self) -> int:
        """How often the worker's process crashed."""
        return self._history.restarts

    @property
    def ended(self) -> str:
        """How the last process that crashed had exited, "" if none crashed."""
        return self._history.ended

    @property
    def beat_at(self) -> float | None:
        """When the last heartbeat arrived, on the monotonic clock; None before the first."""
        return self._run.beat_at

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
        """Seconds in which the worker's process made no progress, computed nothing and sent no heartbeat."""
        return self._run.still if self.phase in {Phase.STARTING, Phase.UP} else 0.0

    @property
    def is_starting(self) -> bool:
        """Whether the worker's process was started by this daemon, is still starting, and makes progress."""
        started_here = self.channel is not None and self.channel.started_here
        return self.phase is Phase.STARTING and started_here and self.still <= self._timing.patience

    @property
    def settled(self) -> bool:
        """Whether the worker is in a stable phase and no reload is pending."""
        return self.phase in {Phase.OFF, Phase.UNAVAILABLE, Phase.UP, Phase.FAILED} and not self._run.reloading

    @property
    def is_reconfiguring(self) -> bool:
        """Whether the process is stopping, or has not applied its new configuration yet."""
        return self.phase is Phase.STOPPING or self._run.reloading

    @property
    def is_service(self) -> bool:
        """Whether a separate service runs the worker."""
        return self._launcher.standing or (self.channel is not None and self.channel.owner == "service")

    def _enter(self, event: WorkerEvent, text: str = "") -> None:
        """Handle an event, unless it may not occur now, and cancel the timer, which belongs to the previous state."""
        if self.state.enter(event, text):
            self._cancel_timer()

    def _call_later(self, seconds: float, callback: Callable[[], None]) -> None:
        self._cancel_timer()
        self._timer = self._loop.call_later(seconds, callback)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._loop.cancel(self._timer)
            self._timer = None

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
            self._start_again = True
        elif self.channel is None:
            self._history.backoff.reset()
            self._launch()
        elif old is None or self.kind.config_part(old) != self.kind.config_part(config):
            self._reconfigure(self.channel, config)

    def _reconfigure(self, channel: WorkerChannel, config: Config) -> None:
        if self._launcher.changes_environment(config):
            self._restart("its environment has changed")
            return
        self._run.reloading = True
        channel.send(protocol.NewConfig(config))

    def _enter_idle(self) -> None:
        """Enter the phase of a disabled or unavailable worker, with the reason."""
        assert self._config is not None
        enabled = self.kind.enabled(self._config)
        missing = self.kind.missing(self._config) if enabled == "auto" else ""
        self._enter(WorkerEvent.MISS if missing else WorkerEvent.DISABLE, missing)
        if missing:
            logger.info("%s is not available: %s", self.name, self.text)

    # -- starting ------------------------------------------------------------------------------------------------------

    def _launch(self) -> None:
        assert self._config is not None
        self._run = WorkerRun()
        self._start_again = False
        launch = self._launcher.launch(self._config)
        if launch.event is WorkerEvent.CANNOT_WORK:
            self._cannot_work(launch.text)
            return
        self.channel = launch.channel
        self._enter(launch.event, launch.text)
        if launch.event is WorkerEvent.BLOCK:
            self._call_later(launch.pause, self._launch)

    def _cannot_work(self, why: str) -> None:
        logger.error("%s cannot work: %s (retrying in %g s)", self.name, why, self._timing.retry)
        self._enter(WorkerEvent.CANNOT_WORK, why)
        self._call_later(self._timing.retry, self._launch)

    # -- reports of the worker -----------------------------------------------------------------------------------------

    def on_report(self, report: protocol.Report) -> None:
        """Handle a report from the worker."""
        match report:
            case Busy(text):
                self._run.on_busy(report)
                if self.phase is Phase.STARTING:
                    self.state.text = text
            case protocol.Beat(_, health):
                self._run.on_heartbeat()
                if self.state.accepts(WorkerEvent.HEARTBEAT):
                    self._on_health(health)
            case protocol.LogLine(level, text):
                logger.log(level, "%s", text, extra={"worker": self.name})
            case protocol.Reloaded():
                self._run.reloading = False
            case protocol.Restart(why):
                if self.state.accepts(WorkerEvent.STOP):
                    self._restart(why)
            case protocol.Failed(why):
                self._run.failure = why
            case protocol.Hello(pid, owner):
                logger.info("%s: connected to process %d, started by a %s", self.name, pid, owner)

    def _on_health(self, health: Health) -> None:
        """Handle a heartbeat; log the first health, and the first that is "running"."""
        named = health.text.startswith(health.state)  # "waiting for ..."
        if (health.state == "running" and not self._run.running) or self.phase is Phase.STARTING:
            self._run.running = health.state == "running"
            logger.info("%s: %s", self.name, health.text if named else f"{health.state} ({health.text})")
        self._history.stalled_starts = 0
        text = health.text if named or health.state == "running" else f"{health.state}: {health.text}"
        self._enter(WorkerEvent.HEARTBEAT, text)

    def on_exit(self, ended: Exit) -> None:
        """Handle the exit of the worker's process."""
        self._launcher.standing = self.is_service
        self.channel = None
        self._run.reloading = False
        if self.phase is Phase.STOPPING:
            logger.info("%s %s", self.name, ended)
            self._enter(WorkerEvent.EXIT)
            self._enter_idle()
            if self._start_again:
                self._launch()
        elif ended.code == protocol.EXIT_CANNOT_WORK:
            self._cannot_work(self._run.failure or "it reported no reason")
        else:
            self._on_crash(self._run.failure or str(ended))

    def _on_crash(self, reason: str) -> None:
        now = time.monotonic()
        pause = self._history.backoff.pause(self.state.age if self.phase is Phase.UP else 0.0)
        self._history.restarts += 1
        self._history.ended = reason
        logger.error("%s %s after %.1f s; restarting in %g s", self.name, reason, now - self._run.started, pause)
        self._enter(WorkerEvent.CRASH, reason)
        self._call_later(pause, self._launch)

    # -- time ----------------------------------------------------------------------------------------------------------

    @property
    def pause(self) -> float:
        """Seconds after which `tick` has to be called again, if the loop reports nothing until then."""
        if self.channel is None and self.phase is not Phase.QUEUED:
            return math.inf
        if self.channel is None or self.phase is not Phase.UP or self.channel.needs_polls:
            return STEP
        return max(STEP, self._limit - self._run.still)

    def tick(self) -> None:
        """Check the process; see `pause`."""
        if self.channel is not None:
            self.channel.poll()
        if self.phase is Phase.QUEUED:
            self._launch()
        elif self.phase in {Phase.STARTING, Phase.UP} and not self._run.killed:
            self._check_progress()

    @property
    def _limit(self) -> float:
        """Longest time without progress in the current phase, in seconds."""
        return self._timing.heartbeat if self.phase is Phase.UP else self._history.start_limit(self._timing)

    def _check_progress(self) -> None:
        """Kill a hung worker, but not one that computes for a long time."""
        match self._run.progress(self._limit):
            case Progress.ENDLESS:
                self._kill(f"is in an endless loop: {self._run.endless_step}")
            case Progress.HUNG:
                self._kill(self._silence())
            case Progress.LATE if (
                self.phase is Phase.UP or self.text
            ):  # before its first report a process has no handler, so the signal would kill it
                if self.channel is not None:
                    self.channel.dump_stacks()

    def _silence(self) -> str:
        limit = self._limit
        if self.phase is Phase.UP:
            return f"sent no heartbeat for {limit:g} s"
        self._history.stalled_starts += 1
        step = self.text or "no report"
        return f"made no progress for {limit:g} s while starting ({step}); the next limit is {self._limit:g} s"

    def forgive(self, seconds: float) -> None:
        """Do not count ``seconds`` in which the daemon itself did not run."""
        self._run.forgive(seconds)

    def _kill(self, why: str) -> None:
        if self._run.killed or self.channel is None:
            return
        self._run.killed = True
        self._run.failure = why
        logger.error("%s %s; killing process %d", self.name, why, self.channel.pid)
        self.kill()

    def kill(self) -> None:
        """Kill the process and its own child processes at once."""
        if self.channel is None:
            return
        if self.channel.pid:
            self.channel.kill()
        else:
            # adopted, but its process id is unknown: the lock names it once this connection is closed
            self.channel.detach()
            self.on_exit(Exit(None))

    # -- stopping ------------------------------------------------------------------------------------------------------

    def _restart(self, why: str) -> None:
        if self.is_service:  # the service restarts the worker, and the daemon adopts it again
            logger.info("%s restarts: %s", self.name, why)
            self._enter(WorkerEvent.STOP, why)
            self._kill_after(self._timing.stop)
        else:
            self.stop(why)
        self._start_again = True

    def stop(self, why: str, seconds: float | None = None) -> None:
        """Ask the worker to stop, and kill it after ``seconds`` if it has not; default: `Timing.stop`."""
        self._start_again = False
        if self.channel is None:
            self._enter(WorkerEvent.DISABLE)
            return
        if self.phase is not Phase.STOPPING:
            logger.info("stopping %s: %s", self.name, why)
            self._run.killed = False
            self._enter(WorkerEvent.STOP, why)
            self.channel.stop()
        self._kill_after(self._timing.stop if seconds is None else seconds)

    def _kill_after(self, seconds: float) -> None:
        self._call_later(seconds, lambda: self._kill("did not stop in time"))

    def release(self) -> None:
        """Disconnect from a worker that continues without this daemon."""
        if self.channel is not None:
            self.channel.detach()
            self.channel = None
        self._enter(WorkerEvent.RELEASE)

"""The daemon: starts and monitors the workers, reloads the configuration, reports, and stops everything in order."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from bridge import state_file
from bridge.config.document import ConfigError
from bridge.config.load import load
from bridge.config.model import Config
from bridge.daemon import log
from bridge.daemon.changed_files import check_changed_files
from bridge.daemon.lock import Lock
from bridge.daemon.log_query import LOG, RecentLines
from bridge.daemon.notify import Notifier
from bridge.daemon.query import RELOAD, STATUS, Phase, QueryServer
from bridge.daemon.readiness import Readiness
from bridge.daemon.rollout import Rollout, stop_order
from bridge.daemon.worker_process import WorkerProcess
from bridge.daemon.worker_run import Timing
from bridge.daemon.workers import worker_kinds
from bridge.resources import raise_open_files
from bridge.state_file import state_folder
from bridge.status import DaemonStatus, WorkerReport
from yarp_compat.selector_loop import SelectorLoop

logger = logging.getLogger("midspan.daemon")

SUSPENDED_AFTER = 0.75
"""A step that ends later than planned by this time, in seconds, means that this process or the machine was suspended;
workers are not penalized for that time."""

STOP_SECONDS = 4.8
AGAIN_SECONDS = 0.5
"""Requests to stop within this time count as one: ``timeout`` and ``make`` signal the daemon and its process group."""

KILLED_SECONDS = 1.0
"""A killed process that still exists after this time hangs in the kernel; not part of `STOP_SECONDS`."""

_STOP_LIMITS = ((2.8, 2.8, 1.2), (2.9, 1.7, 3.0), (3.9, 1.0, STOP_SECONDS))
"""Three times in seconds for each group of `stop_order`. The first is when its workers are killed, counted from the
start of the whole stop; the second is the minimum time between their stop request and this kill. The third, also from
the start, is when the next group is asked to stop, even if workers of earlier groups have not exited."""


def usable_cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class ConfigSource:
    """Loads the daemon's configuration file, and adds the daemon's name and state folder.

    If ``file`` is None, each load searches for a file.

    Attributes:
        first: the configuration at the start.
        machine_name: the name that the file sets, else the machine's name.
    """

    def __init__(self, file: Path | None, environ: Mapping[str, str]) -> None:
        loaded = load(file)
        self.file = file
        self.first = state_file.with_state(loaded, environ)
        self.machine_name = loaded.name
        self._environ = environ

    def reload(self, running: Config) -> Config:
        """Load the file again.

        Raises `ConfigError`, and `RuntimeError` for a change that needs a restart, or a file that cannot be used.
        """
        config = state_file.named(load(self.file), self._environ)
        # The folder in use may be full or read-only by now: that is reported, but must not make the reload fail.
        config = config.model_copy(update={"state": state_folder(config, self._environ).absolute()})
        for key in ("name", "state"):
            old, new = getattr(running, key), getattr(config, key)
            if old != new:
                change = f"{key}: changing it from '{old}' to '{new}'"
                raise RuntimeError(f"{self.file}: {change} needs a restart of the daemon")
        check_changed_files(running, config)
        return config


class Supervisor:
    """Starts, monitors and stops the workers, all in the daemon's only thread.

    If ``file`` is None, each load searches for a file. The supervisor adopts the ``standing`` workers, which run as
    separate services. At most ``cores`` workers start at once; the default is the number that this process may use.

    Attributes:
        loop: the selector loop of that thread.
    """

    def __init__(
        self, file: Path | None, *, standing: Collection[str] = (), timing: Timing | None = None,
        cores: int | None = None, environ: Mapping[str, str] = os.environ,
    ) -> None:  # fmt: skip
        self._source = ConfigSource(file, environ)
        self._config = self._source.first
        self.loop = SelectorLoop()
        self._notify = Notifier(environ)
        self._readiness = Readiness(self._notify, self.status, lambda: state_folder(self._config))
        self._cores = cores or usable_cores()
        timing = timing or Timing()
        self.workers = [
            WorkerProcess(self.loop, kind, timing, standing=kind.name in standing, first=self._first)
            for kind in worker_kinds(environ).values()
        ]
        self._stops = 0
        self._stop_requested = 0.0
        self._reload_wanted = False
        self._rollout = Rollout(self._config, self.workers, timing.apply)
        self._refused = ""
        self._begun = self._stepped = time.monotonic()

    @property
    def config(self) -> Config:
        return self._config

    # -- from signal handlers and other threads ------------------------------------------------------------------------

    def request_stop(self) -> None:
        """Stop in order; another request after `AGAIN_SECONDS` kills the workers at once."""
        now = time.monotonic()
        if not self._stops:
            self._stop_requested = now
        elif now < self._stop_requested + AGAIN_SECONDS:
            return
        self._stops += 1
        self.loop.wake()

    def request_reload(self) -> None:
        """Load the configuration again."""
        self._reload_wanted = True
        self.loop.wake()

    # -- the loop ------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Run until a stop request; raises `RuntimeError` if the state folder is unusable, or the same daemon runs."""
        socket, kept = state_file.daemon_socket(self._config), RecentLines()
        lock = self._lock_state_folder()
        verbs = {STATUS: lambda _: self.document(), LOG: kept.respond, RELOAD: lambda _: self._reload()}
        query = QueryServer(self.loop, socket, verbs)
        logging.getLogger().addHandler(kept)
        self._begun = self._stepped = time.monotonic()
        try:
            logger.info("%s: limit of open files %d", self._config.name, raise_open_files())
            machine = self._source.machine_name
            if machine != self._config.name:
                reason = "this daemon keeps the name of its first start, under which its state is stored"
                logger.warning("%s: the machine's name is %s now; %s", self._config.name, machine, reason)
            self._readiness.begin()
            for worker in self.workers:
                worker.configure(self._config)
            while not self._stops:
                self._step()
                if self._reload_wanted:
                    self._reload_wanted = False
                    self._reload()
        finally:
            self._end()
            logging.getLogger().removeHandler(kept)
            query.close()
            lock.close()
            self._notify.close()
            self.loop.close()

    def _lock_state_folder(self) -> Lock:
        lock = Lock(state_file.daemon_lock(self._config))
        if lock.try_lock():
            lock.write(os.getpid(), "daemon")
            return lock
        holder = lock.holder()
        lock.close()
        user = f"process {holder.pid} of {holder.machine}" if holder else "another process"
        fault = f"a daemon named '{self._config.name}' already runs ({user}) with the state folder {self._config.state}"
        raise RuntimeError(f"{fault}; stop it, or give this one another 'name' or 'state'")

    def _first(self) -> str:
        """Return what must happen before another process may start, "" if it may start now.

        Starting all workers at once, or restarting them, only slows each of them. They start in the order of `workers`:
        first those that outlive the daemon, such as the router; then the sides; then others, such as the modules.
        """
        if pending := self._rollout.pending:
            return f"{' and '.join(pending)} to apply the new configuration"
        starting = [worker.name for worker in self.workers if worker.is_starting]
        return f"{' and '.join(starting)} to start" if len(starting) >= self._cores else ""

    def _step(self) -> None:
        interval = self._notify.watchdog_interval
        pauses = (self._readiness.pause, self._rollout.pause, interval / 2 if interval else math.inf)
        pause = min(*pauses, *(worker.pause for worker in self.workers))
        self.loop.step(pause)
        now = time.monotonic()
        late = now - self._stepped - pause
        self._stepped = now
        for worker in self.workers:
            if late > SUSPENDED_AFTER:
                worker.forgive(late)
        self._rollout.step()
        for worker in self.workers:
            worker.tick()
        self._readiness.step(now, self._settled)

    def _settled(self) -> bool:
        """Return whether all workers have started, or cannot, and none has an older configuration."""
        return not self._rollout.pending and all(worker.settled for worker in self.workers)

    def status(self) -> str:
        """Return the state of all workers in one line."""
        parts = []
        for worker in self.workers:
            if worker.phase is Phase.OFF:
                continue
            if worker.phase is Phase.UP and worker.text.startswith(("waiting", "standby")):
                text = f"{worker.name} {worker.text}"
            else:
                text = f"{worker.name} {worker.phase.value}" + (f": {worker.text}" if worker.text else "")
            if worker.phase is Phase.STARTING:
                text += f" ({time.monotonic() - worker.since:.0f} s)"
            if worker.restarts:
                text += f" (restarted {worker.restarts}x)"
            parts.append(text)
        if self._readiness.trouble:
            parts.append(self._readiness.trouble)
        if self._refused:
            parts.append(f"reload refused, the running configuration is kept: {self._refused}")
        return " | ".join(parts) or "no worker is enabled"

    def document(self) -> dict[str, Any]:
        """Return the document that `bridge.daemon.query.ask_daemon` receives."""
        reports = [
            WorkerReport(
                worker=worker.name,
                phase=worker.phase.value,
                text=worker.text,
                since=round(time.monotonic() - worker.since, 1),
                still=round(worker.still, 1),
                beat=None if worker.beat_at is None else round(time.monotonic() - worker.beat_at, 2),
                pid=worker.pid,
                restarts=worker.restarts,
                ended=worker.ended,
            )
            for worker in self.workers
        ]
        return DaemonStatus(
            daemon=self._config.name,
            pid=os.getpid(),
            uptime=round(time.monotonic() - self._begun, 1),
            config=None if self._source.file is None else str(self._source.file.absolute()),
            refused=self._refused,
            status=self.status(),
            workers=reports,
        ).document()

    # -- reload --------------------------------------------------------------------------------------------------------

    def _reload(self) -> dict[str, Any]:
        """Load the configuration again; return the response to a reload request: why it is rejected, or ""."""
        if self._stops:  # a request during the stop
            return {"rejected": "the daemon is stopping"}
        self._notify.reloading()
        try:
            config = self._source.reload(self._config)
        except (ConfigError, OSError, RuntimeError) as err:
            logger.error("the new configuration is rejected, the running one is kept:\n%s", err)  # noqa: TRY400
            first, *more = str(err).splitlines()
            self._refused = f"{first} (and {len(more)} more)" if more else first
            self._readiness.announce_again()
            return {"rejected": str(err)}
        logger.info("configuration reloaded")
        self._refused = ""
        log.set_level(config)
        self._config = config
        self._readiness.begin()
        self._rollout.begin(config)
        return {"rejected": ""}

    # -- the end -------------------------------------------------------------------------------------------------------

    def _end(self) -> None:
        """Stop all workers within `STOP_SECONDS`, in the order of `stop_order`."""
        self._notify.stopping()
        self._notify.status("stopping")
        begun = time.monotonic()
        for worker in self.workers:
            if worker.is_service:
                worker.release()
        asked: list[WorkerProcess] = []
        for group, (killed_after, at_least, next_after) in zip(stop_order(self.workers), _STOP_LIMITS, strict=True):
            asked += group
            seconds = max(at_least, begun + killed_after - time.monotonic())
            for worker in group:
                worker.stop("the daemon stops", seconds)
            self._wait_for_end(asked, begun + next_after)
        self._kill_the_rest()
        logger.info("stopped after %.1f s", time.monotonic() - begun)

    def _wait_for_end(self, group: list[WorkerProcess], end: float) -> None:
        while not all(worker.idle for worker in group) and time.monotonic() < end:
            if self._stops > 1:
                for worker in group:
                    worker.kill()
            self._step_workers([worker for worker in self.workers if not worker.idle])

    def _step_workers(self, workers: list[WorkerProcess]) -> None:
        self.loop.step(0.05)
        for worker in workers:
            worker.tick()
        self._notify.feed_watchdog()

    def _kill_the_rest(self) -> None:
        """Kill the remaining workers: an earlier SIGKILL may not have been sent if this process was suspended."""
        remaining = [worker for worker in self.workers if not worker.idle]
        for worker in remaining:
            worker.kill()
        end = time.monotonic() + KILLED_SECONDS
        while not all(worker.idle for worker in remaining) and time.monotonic() < end:
            self._step_workers(remaining)
        for worker in remaining:
            if not worker.idle:
                logger.error("%s: process %d does not exit, even after SIGKILL", worker.name, worker.pid)
                worker.release()

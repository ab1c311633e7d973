"""A worker's process and its main loop, with the daemon's pipes, a control socket, systemd, or none of them.

The main loop starts the worker, polls its health, passes commands to it, and stops it. Signals, the daemon's pipe and
the control socket put commands into one queue; reports go to a function. The same loop therefore serves a supervised
worker, one that outlives its daemon, and one without a daemon.
"""

from __future__ import annotations

import gc
import logging
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from enum import Enum
from typing import Protocol

from bridge import resources, state_file
from bridge.adapters.memory import few_heaps
from bridge.config.model import Config
from bridge.daemon import log, protocol
from bridge.daemon.changed_files import check_changed_files
from bridge.daemon.control import Commands, ControlServer, DaemonPipe, Hangup, with_pipe
from bridge.daemon.heartbeat import dump_stacks_on_signal
from bridge.daemon.lock import INHERITED, Lock
from bridge.daemon.notify import Notifier
from bridge.daemon.succession import Successor, succeed
from bridge.daemon.workers import WorkerKind
from bridge.hub.errors import HubError
from bridge.hub.panics import failure
from bridge.hub.security.zenoh_log import ZenohLog
from bridge.progress import working
from bridge.resources import LARGE_MESSAGES, raise_open_files
from bridge.ticks import until_tick
from bridge.worker import Health, Worker, WorkerFailedError

logger = logging.getLogger("midspan.worker")

_CHECK_INTERVAL = 4
"""Heartbeats between checks of the free file descriptors, and of zenoh."""

_FAILED_SECONDS = 3.0
"""Time for a worker to stop its robot after zenoh has failed in its process, because closing sessions may hang."""


class RunEnd(Enum):
    """How a worker's run ended."""

    STOPPED = "stopped"
    FAILED = "failed"
    CANNOT_WORK = "cannot work"
    NEEDS_RESTART = "needs a restart"


class Companion(Protocol):
    """An additional task in the worker's process; see `bridge.metrics.on_demand`."""

    def on_heartbeat(self, config: Config) -> None:
        """Run at each heartbeat; must not block."""

    def close(self) -> None:
        """Stop, before the worker stops."""


class WorkerLoop:
    """The main loop of one worker.

    ``report`` must not block for long. ``load`` loads the configuration on SIGHUP; it is None if the daemon sends the
    configuration. With ``end_for_restart``, the run ends if a reload needs a restart. ``companion`` is called at each
    heartbeat.
    """

    def __init__(
        self, worker: Worker, commands: Commands, report: Callable[[protocol.Report], None], *,
        load: Callable[[], Config] | None = None, end_for_restart: bool = False, companion: Companion | None = None,
    ) -> None:  # fmt: skip
        self._worker = worker
        self._commands = commands
        self._report = report
        self._load = load
        self._end_for_restart = end_for_restart
        self._config: Config
        self._beats = 0
        self._last_health: Health | None = None
        self._answering = True
        self._short = False
        self._companion = companion

    def run(self, config: Config) -> RunEnd:
        """Run until stopped, or until the worker fails with a known reason; other exceptions propagate."""
        self._config = config
        try:
            return self._run()
        finally:
            if self._companion is not None:
                self._companion.close()
            self._worker.stop()

    def _run(self) -> RunEnd:
        try:
            with working.busy("starting"):
                self._worker.start(self._config)
        except RuntimeError as err:
            logger.error("cannot work here: %s", err)  # noqa: TRY400  a known reason, not a bug
            self._report(protocol.Failed(str(err)))
            return RunEnd.CANNOT_WORK
        except HubError as err:  # for example, the router of a zenoh client is not running
            return self._failed(str(err))
        due = time.monotonic()
        while True:
            if due <= time.monotonic():
                try:
                    due = time.monotonic() + self._beat()
                except WorkerFailedError as err:
                    return self._failed(str(err))
            try:  # even if the next heartbeat is due already: on a busy machine that may always be the case
                command = self._commands.get(timeout=max(due - time.monotonic(), 0.0))
            except queue.Empty:
                continue
            outcome = self._on_command(command)
            if outcome is not None:
                return outcome

    def _failed(self, reason: str) -> RunEnd:
        """End the run for a reason that may be temporary; the daemon then starts a new process."""
        logger.error("%s", reason)
        self._report(protocol.Failed(reason))
        return RunEnd.FAILED

    def _beat(self) -> float:
        """Report the worker's health; return the seconds until the next report."""
        try:
            with working.busy("reporting its health"):
                health = self._worker.health()
        except TimeoutError as err:
            if self._answering:
                logger.error("the worker's loop does not respond: %s", err)  # noqa: TRY400
            self._answering = False
            return protocol.BEAT_INTERVAL
        self._answering = True
        self._beats += 1
        if self._beats % _CHECK_INTERVAL == 0:
            self._check_descriptors()
            self._check_zenoh()
        LARGE_MESSAGES.trim()
        if self._companion is not None:
            self._companion.on_heartbeat(self._config)
        self._report(protocol.Beat(self._beats, health))
        before, self._last_health = self._last_health, health
        quiet = health == before and health.state == "running"
        return until_tick(protocol.QUIET_INTERVAL) if quiet else protocol.BEAT_INTERVAL

    def _check_descriptors(self) -> None:
        """Log when a shortage begins and ends, because a router without free descriptors cannot respond to queries."""
        short = resources.descriptors()
        if bool(short) != self._short:
            self._short = bool(short)
            logger.warning("%s", short or "file descriptors are available again")

    def _check_zenoh(self) -> None:
        """Raise `WorkerFailedError` if zenoh has failed; the process then exits even if the worker's stop hangs."""
        if reason := failure():
            end = threading.Timer(_FAILED_SECONDS, os._exit, (1,))
            end.daemon = True
            end.start()
            raise WorkerFailedError(reason)

    def _on_command(self, command: protocol.Command | Hangup) -> RunEnd | None:
        match command:
            case protocol.Stop(why):
                logger.info("stopping: %s", why)
                return RunEnd.STOPPED
            case protocol.NewConfig(config):
                return self._reload(config)
            case Hangup():
                return self._hangup()

    def _hangup(self) -> RunEnd | None:
        if self._load is None:
            return None
        from bridge.config.document import ConfigError

        try:
            config = self._load()
            check_changed_files(self._config, config)
        except (ConfigError, OSError, RuntimeError) as err:  # the state folder may be full or read-only by now
            logger.error("the new configuration is rejected, the running one is kept:\n%s", err)  # noqa: TRY400
            self._report(protocol.Reloaded())
            return None
        return self._reload(config)

    def _reload(self, config: Config) -> RunEnd | None:
        if config == self._config:
            self._report(protocol.Reloaded())
            return None
        log.set_level(config)
        with working.busy("applying the new configuration"):
            done = self._worker.reload(config)
        if done:
            self._config = config
            logger.info("configuration applied")
            self._report(protocol.Reloaded())
            return None
        self._report(protocol.Restart("the new configuration needs a restart"))
        return RunEnd.NEEDS_RESTART if self._end_for_restart else None


def install_signals(commands: Commands) -> None:
    """Queue a stop on SIGTERM and SIGINT, and a reload on SIGHUP. Call from the main thread."""
    for stop in (signal.SIGTERM, signal.SIGINT):
        signal.signal(stop, lambda number, _frame: commands.put(protocol.Stop(signal.Signals(number).name)))
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, lambda _number, _frame: commands.put(Hangup()))


class WorkerMain:
    """The process of one worker; with a control socket (``control``) it outlives its daemon.

    ``companion`` creates the companion of a worker with a given name.
    """

    def __init__(self, kind: WorkerKind, companion: Callable[[Worker, str], Companion], *, control: bool) -> None:
        self._kind = kind
        self._companion = companion
        self._control = control
        few_heaps()
        self._commands = Commands()
        install_signals(self._commands)
        dump_stacks_on_signal()

    def run_supervised(self) -> int:
        """Run under the daemon; return the exit code."""
        pipe = DaemonPipe()
        first = pipe.first_config()
        if first is None:
            return 0
        config = first.config
        relay = log.RelayHandler() if self._control else None
        log.setup(config, self._kind.name, log.Style.SUPERVISED, relay)
        lock = server = None
        try:
            if not INHERITED:
                lock = self._lock(config, "daemon")
            if self._control:
                server = self._open_control(config, "daemon", self._commands.put)
        except RuntimeError as err:
            logger.error("cannot work here: %s", err)  # noqa: TRY400  the daemon reads it from stderr
            return protocol.EXIT_CANNOT_WORK
        try:
            return self._run_under_daemon(config, pipe, relay, server)
        finally:
            if lock is not None:
                lock.close()

    def _run_under_daemon(
        self, config: Config, pipe: DaemonPipe, relay: log.RelayHandler | None, server: ControlServer | None
    ) -> int:
        if relay is None or server is None:
            pipe.read_to(self._commands, stop_at_end=True)
            return self._run(config, pipe.report) or 0
        relay.relay_to(server.relay)
        report = with_pipe(server, pipe.report)
        pipe.heartbeat.send_to(report)
        try:
            return self._run(config, report) or 0
        finally:
            server.close()

    def run_alone(self, config: Config, load: Callable[[], Config]) -> int | None:
        """Run without a daemon; return the exit code, or None if a new configuration needs a new process."""
        log.setup(config, self._kind.name, log.style_for())
        raise_open_files()
        notifier = Notifier()
        if self._control and self._kind.enabled(config) is False:
            logger.info("%s is disabled by the configuration", self._kind.name)
            notifier.ready()  # systemd treats an exit before this as a failure
            return 0
        successor = Successor()
        self._kind.create()  # imports the worker's code before the predecessor exits
        lock = succeed(lambda: self._lock(config, "service"))
        server = self._open_control(config, "service", self._on_service_command) if self._control else None
        ready = False

        def report(report: protocol.Report) -> None:
            nonlocal ready
            if server is not None:
                server.report(report)
            if isinstance(report, protocol.Beat):
                notifier.status(report.health.text)
                notifier.feed_watchdog()
                if not ready:
                    notifier.ready()
                    ready = True

        try:
            return self._run(config, report, load)
        finally:
            if successor.pid:
                notifier.main_process(successor.pid)
            else:
                notifier.stopping()
            notifier.close()
            if server is not None:
                server.close()
            lock.close()

    def _on_service_command(self, command: protocol.Command) -> None:
        """Handle a daemon's command; for a new configuration, a service reloads its own file."""
        self._commands.put(Hangup() if isinstance(command, protocol.NewConfig) else command)

    def _run(
        self, config: Config, report: Callable[[protocol.Report], None], load: Callable[[], Config] | None = None
    ) -> int | None:
        zenoh_log = ZenohLog.capture()
        try:
            working.at(f"loading the code of {self._kind.name}")
            worker = self._kind.create()
            gc.enable()
            companion = self._companion(worker, self._kind.name)
            loop = WorkerLoop(
                worker, self._commands, report, load=load, end_for_restart=load is not None, companion=companion
            )
            outcome = loop.run(config)
        except Exception:
            logger.exception("%s failed", self._kind.name)
            return 1
        finally:
            zenoh_log.release()
        if outcome is RunEnd.NEEDS_RESTART:
            return None
        return {RunEnd.CANNOT_WORK: protocol.EXIT_CANNOT_WORK, RunEnd.FAILED: 1}.get(outcome, 0)

    def _open_control(
        self, config: Config, owner: protocol.Owner, on_command: Callable[[protocol.Command], None]
    ) -> ControlServer:
        return ControlServer(state_file.control_socket(config, self._kind.name), owner, on_command)

    def _lock(self, config: Config, owner: protocol.Owner) -> Lock:
        """Lock the worker, so that it has at most one process, with or without a daemon of the same name."""
        lock = Lock(state_file.worker_lock(config, self._kind.name))
        if lock.try_lock():
            lock.write(os.getpid(), owner)
            return lock
        holder = lock.holder()
        lock.close()
        process = f"as process {holder.pid} of {holder.machine}" if holder else "in another process"
        fault = f"the worker {self._kind.name} of '{config.name}' already runs {process}"
        raise RuntimeError(f"{fault}; stop it, or give this one another 'name' or 'state'")

"""A worker's process: joins its main loop to the daemon's pipes, to a control socket, to systemd, or to nobody."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from bridge.config.model import Config
from bridge.daemon import log, state
from bridge.daemon.child import Child, Commands, Hangup, Outcome, install_signals
from bridge.daemon.limits import raise_open_files
from bridge.daemon.notify import Notifier
from bridge.daemon.pipe import DaemonPipe
from bridge.daemon.protocol import EXIT_CANNOT_WORK, Beat, Command, NewConfig, Owner, Report
from bridge.daemon.stacks import tell_stacks_on_signal
from bridge.daemon.workers import WorkerKind

if TYPE_CHECKING:
    from bridge.daemon.control import ControlServer
    from bridge.daemon.lock import Lock

logger = logging.getLogger("midspan.worker")


class Process:
    """This process, as that of one worker.

    Args:
        kind: which worker.
        control: whether it has a control socket and so outlives its daemon.
    """

    def __init__(self, kind: WorkerKind, *, control: bool) -> None:
        self._kind = kind
        self._control = control
        self._commands = Commands()
        install_signals(self._commands)
        tell_stacks_on_signal()

    def run_supervised(self) -> int:
        """Run under the daemon; the exit code."""
        pipe = DaemonPipe()
        first = pipe.first_config()
        if first is None:
            return 0
        config = first.config
        if not self._control:
            log.setup(config, self._kind.name, log.Style.SUPERVISED)
            pipe.read_to(self._commands, stop_at_end=True)
            return self._run(config, pipe.report) or 0
        relay = log.RelayHandler()
        log.setup(config, self._kind.name, log.Style.SUPERVISED, relay)
        try:
            server = self._open_control(config, "daemon", self._commands.put)
        except RuntimeError as err:
            logger.error("cannot work here: %s", err)  # noqa: TRY400  the daemon reads it as last words
            return EXIT_CANNOT_WORK
        relay.relay_to(server.relay)
        try:
            return self._run(config, server.report) or 0
        finally:
            server.close()

    def run_alone(self, config: Config, load: Callable[[], Config]) -> int | None:
        """Run without a daemon; the exit code, or None where a new configuration needs this process to start again."""
        log.setup(config, self._kind.name, log.style_for())
        raise_open_files()
        notifier = Notifier()
        if self._control and self._kind.enabled(config) is False:
            logger.info("%s is switched off by the configuration", self._kind.name)
            notifier.ready()  # ended as it should; to systemd an end before this is a failure
            return 0
        lock = self._lock(config)
        server = self._open_control(config, "service", self._obey_as_service) if self._control else None
        ready = False

        def report(said: Report) -> None:
            nonlocal ready
            if server is not None:
                server.report(said)
            if isinstance(said, Beat):
                notifier.status(said.health.text)
                notifier.feed_watchdog()
                if not ready:
                    notifier.ready()
                    ready = True

        try:
            return self._run(config, report, load)
        finally:
            notifier.stopping()
            notifier.close()
            if server is not None:
                server.close()
            if lock is not None:
                lock.close()

    def _obey_as_service(self, command: Command) -> None:
        """A service has its own file: a daemon's new configuration means to load that again."""
        self._commands.put(Hangup() if isinstance(command, NewConfig) else command)

    def _run(
        self, config: Config, report: Callable[[Report], None], load: Callable[[], Config] | None = None
    ) -> int | None:
        try:
            worker = self._kind.create()
            child = Child(worker, self._commands, report, load=load, end_for_restart=load is not None)
            outcome = child.run(config)
        except Exception:
            logger.exception("%s failed", self._kind.name)
            return 1
        if outcome is Outcome.NEEDS_RESTART:
            return None
        return EXIT_CANNOT_WORK if outcome is Outcome.CANNOT_WORK else 0

    def _open_control(self, config: Config, owner: Owner, obey: Callable[[Command], None]) -> ControlServer:
        from bridge.daemon.control import ControlServer

        return ControlServer(state.control_socket(config, self._kind.name), owner, obey)

    def _lock(self, config: Config) -> Lock | None:
        """One process a worker, also beside a daemon of the same name."""
        if sys.platform == "win32":
            return None
        import os

        from bridge.daemon.lock import Lock

        lock = Lock(state.worker_lock(config, self._kind.name))
        if lock.try_lock():
            lock.write(os.getpid(), "service")
            return lock
        holder = lock.holder()
        lock.close()
        who = f"as process {holder.pid} of {holder.machine}" if holder else "in another process"
        what = f"the worker {self._kind.name} of '{config.name}' already runs {who}"
        msg = f"{what}; stop it, or give this one another 'name' or 'state'"
        raise RuntimeError(msg)

"""The worker of the embedded master, which keeps running while the daemon restarts."""

from __future__ import annotations

import _thread
import signal
from pathlib import Path

from typing_extensions import override

from bridge.adapters.ros1.master.embedded import EmbeddedMaster
from bridge.config.model import Config
from bridge.config.sections.listen import split
from bridge.state_file import worker_folder
from bridge.worker import Health, Worker, WorkerFailedError


class MasterWorker(Worker):
    """Runs a ROS 1 master at ``ros1.listen``.

    With ``stoppable``, nodes may end the process by calling ``shutdown`` of the API.
    """

    def __init__(self, *, stoppable: bool = False) -> None:
        self._stoppable = stoppable
        self._config: Config | None = None
        self._master: EmbeddedMaster | None = None

    @override
    def start(self, config: Config) -> None:
        """Listen; raises `RuntimeError` if another program, such as a roscore, has the port."""
        self._config = config
        ros1 = config.ros1
        try:
            self._master = EmbeddedMaster(
                *split(ros1.listen), ros1.embedded_uri, state=state_file(config), purge=ros1.purge,
                shut_down=_end if self._stoppable else None,
            )  # fmt: skip
        except OSError as err:
            raise RuntimeError(
                f"the ROS 1 master cannot listen on {ros1.listen}: {err.strerror}; stop the roscore there, or set"
                " ros1.listen to another address"
            ) from None
        self._master.start()

    @override
    def reload(self, config: Config) -> bool:
        """Apply a new configuration; a changed address, state file or ``ros1.purge`` needs a restart."""
        old, self._config = self._config, config
        return old is not None and _settings(old) == _settings(config)

    @override
    def health(self) -> Health:
        if self._master is None:
            raise WorkerFailedError("the master is closed")
        count = len(self._master.nodes())
        return Health("running", f"{'1 node' if count == 1 else f'{count} nodes'} at {self._master.uri}")

    @override
    def stop(self) -> None:
        """Stop serving; the nodes stay registered in the state file."""
        master, self._master = self._master, None
        if master is not None:
            master.close()


def create_stoppable() -> MasterWorker:
    """Create the worker for a process without a daemon."""
    return MasterWorker(stoppable=True)


def state_file(config: Config) -> Path:
    """Return the file of the master's registrations and parameters."""
    return worker_folder(config) / "ros1-master.json"


def _end() -> None:
    _thread.interrupt_main(signal.SIGTERM)  # on Windows os.kill would end the process at once


def _settings(config: Config) -> tuple[object, ...]:
    return config.name, config.state, config.ros1.embedded_uri, config.ros1.listen, config.ros1.purge

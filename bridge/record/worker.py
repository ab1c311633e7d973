"""The worker ``record``, which records in the daemon."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import Any

from typing_extensions import override

from bridge import __version__
from bridge.config.model import Config
from bridge.hub.errors import HubError
from bridge.messages.registry import Registry
from bridge.modules.host import Host
from bridge.record.places import KeptFolder, RecordPlace
from bridge.record.recorder import Recorder
from bridge.record.ring import Ring
from bridge.record.section import RecordSection
from bridge.record.status import RecordingStatus
from bridge.record.taps import Taps
from bridge.record.triggers import Triggers
from bridge.state_file import worker_folder
from bridge.status import WorkerStatus
from bridge.worker import Health, StatusHead, Worker

_log = logging.getLogger("midspan.record")

VERB = "record"
"""The request on the control plane, with the parameter ``do``: ``start``, ``stop``, ``split`` or ``trigger``."""

_NICE = 5
_REFRESH_SECONDS = 0.25
_RETRY_SECONDS = 5.0


class Recording:
    """A recorder with its node on the hub, which follows the hub's topics until it is closed.

    Args:
        name: the name of the node, and on the control plane.

    Raises:
        HubError: the hub cannot be joined.
    """

    def __init__(self, name: str, config: Config, section: RecordSection, place: RecordPlace) -> None:
        registry = Registry.of(config.types)
        self._changed = Event()
        about = {"daemon": config.name, "version": __version__}
        with low_priority():
            self.host = Host(name, config, registry)
            self.recorder = Recorder(self.host.node.hub, registry, section, place, about, self._changed.set)
        self._taps = Taps(self.host.node.hub, self.recorder.selection)
        self.triggers: Triggers | None = None
        self._refreshes = 0
        self.host.loop.start()
        self.host.loop.every(_REFRESH_SECONDS, self._refresh)

        self._head = StatusHead({"side": "record"}, uptime=False)
        self.host.answer("status", self._status)

    def _status(self, _params: Any) -> dict[str, Any]:
        status = self.recorder.status()
        state = "waiting" if status.error else "running"
        error = {"error": f"recording stopped: {status.error}"} if status.error else {}
        head = self._head.fields(state, summary(status), recording=status, **error)
        # a name of metrics for each process of `midspan record` would remain in Prometheus
        exported = metrics(status) if self.host.name == VERB else {}
        return WorkerStatus(**head, metrics=exported).document()

    @property
    def joined(self) -> bool:
        """Whether a router of the hub answers."""
        return self.host.node.hub.linked()

    def add_triggers(self, section: RecordSection) -> None:
        """Start the configured triggers."""
        self.triggers = Triggers(self.host, section.trigger, self.recorder.trigger)
        self._changed.set()

    def _refresh(self) -> None:
        self._taps.refresh()
        self._refreshes += 1
        # refresh even without changes, to drop topics that left the hub, and to retry failed subscriptions
        if self._changed.is_set() or self._refreshes % int(_RETRY_SECONDS / _REFRESH_SECONDS) == 0:
            self._changed.clear()
            topics = self.recorder.refresh()
            if self.triggers is not None:
                self.triggers.refresh(topics)

    def close(self) -> None:
        """Write all waiting messages, and leave the hub."""
        if self.triggers is not None:
            self.triggers.close()
        self.recorder.close()
        self._taps.close()
        self.host.close()


@contextmanager
def low_priority() -> Iterator[None]:
    """Lower the priority of threads that start in this context (Linux), so that publishers do not wait for them.

    Threads that zenoh's threads start later inherit the priority, even if they do other work of the process.
    """
    before = _threads()
    yield
    for thread in _threads() - before:
        with suppress(OSError):  # the thread has just ended
            os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, os.getpid()) + _NICE)
            # a message's arrival at the recorder must not preempt the topic's other subscribers
            os.sched_setscheduler(thread, os.SCHED_BATCH, os.sched_param(0))


def _threads() -> set[int]:
    tasks = Path("/proc/self/task")
    return {int(task.name) for task in tasks.iterdir()} if tasks.is_dir() else set()


def default_folder(config: Config) -> Path:
    """Return the folder of the daemon's recordings."""
    return config.section(RecordSection).folder or worker_folder(config) / "recordings"


def ring_or_files(folder: KeptFolder, section: RecordSection) -> RecordPlace:
    """Return the place of the files: a ring if the section configures one, else the folder."""
    return Ring(folder, section.ring) if section.ring.seconds else folder


class RecordWorker(Worker):
    """Records as configured, and runs commands from ``midspan record --daemon``."""

    def __init__(self) -> None:
        self._config: Config | None = None
        self._recording: Recording | None = None

    @override
    def start(self, config: Config) -> None:
        """Join the hub and start recording; if the folder cannot be written, the recorder retries."""
        self._config = config
        section = config.section(RecordSection)
        place = ring_or_files(KeptFolder(default_folder(config), section.keep), section)
        recording = self._recording = Recording("record", config, section, place)
        if section.ring.seconds:
            recording.add_triggers(section)
        recording.host.answer(VERB, self._do)
        try:
            _log.info("recording into %s", recording.recorder.begin())
        except TimeoutError as err:
            _log.warning("recording has not started yet: %s", err)
        except OSError:
            _log.debug("recording did not start, as the recorder logged", exc_info=True)

    @override
    def reload(self, config: Config) -> bool:
        return config == self._config

    @override
    def health(self) -> Health:
        """Return the recorder's state; raises `TimeoutError` if a thread hangs."""
        assert self._recording is not None
        self._recording.host.loop.computes()
        self._recording.recorder.computes()
        status = self._recording.recorder.status()
        return Health("waiting" if status.error else "running", summary(status))

    def _do(self, params: dict[str, Any]) -> dict[str, Any]:
        """Run a command; raises `HubError` if it fails."""
        assert self._recording is not None
        recorder, verb = self._recording.recorder, params.get("do")
        try:
            if verb == "start":
                path = recorder.begin()
            elif verb == "stop":
                path = recorder.pause()
            elif verb == "split":
                path = recorder.split()
            elif verb == "trigger":
                path = recorder.keep("midspan record --daemon trigger")
            else:
                raise HubError(f"{verb!r} is not one of start, stop, split and trigger")
        except OSError as err:
            raise HubError(f"{verb}: {err}") from None
        return {"file": str(path or ""), "recording": recorder.status().document()}

    @override
    def stop(self) -> None:
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.close()


def metrics(status: RecordingStatus) -> dict[str, float]:
    """Return a recording's metrics for Prometheus, without labels; each known drop reason exists from the start."""
    dropped = {reason: status.dropped.get(reason, 0) for reason in ("queue", "disk", "lost", "refused")}
    return {
        "written_messages_total": status.messages,
        "written_bytes_total": status.bytes,
        "files_total": status.files,
        "topics": len(status.topics),
        "recording": float(status.state == "recording"),
        "blocked": float(status.state == "blocked"),
        **{f"dropped_{reason}_total": count for reason, count in dropped.items()},
    }


def summary(status: RecordingStatus) -> str:
    """Return a recording's status in one line."""
    if status.state == "stopped":
        return "stopped; 'midspan record --daemon start' continues"
    dropped = sum(status.dropped.values())
    reasons = ", ".join(f"{count} {reason}" for reason, count in status.dropped.items())
    drops = f", {dropped} dropped ({reasons})" if dropped else ""
    figures = f"{status.messages} messages, {status.bytes / 1e6:.1f} MB, {len(status.topics)} topics{drops}"
    if status.state == "blocked":
        return f"not recording: {status.error}; {figures}"
    return f"{'ring' if status.ring else 'recording'} {status.file}, {figures}"

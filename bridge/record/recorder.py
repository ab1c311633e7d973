"""Records selected topics of the hub: it subscribes to them, and writes their messages on a separate thread.

Messages that the status counts as written can be read even if the process is killed, because chunks are closed after a
megabyte or a second. When the disk is full, the file is closed, messages are dropped and counted, and recording
continues in a new file as soon as there is space.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

from bridge.client.topics import HubTopic, HubTopics, TopicKey
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.record.arrivals import ArrivalQueue
from bridge.record.file import total
from bridge.record.places import RecordPlace
from bridge.record.section import RecordSection
from bridge.record.selection import Selection
from bridge.record.series import FileSeries
from bridge.record.status import RecordingStatus
from bridge.record.subscriptions import RecordedTopics

_log = logging.getLogger("midspan.record")

GATHER_SECONDS = 0.05
"""Seconds for which messages are batched before they are written, unless a batch is full earlier."""

STILL_SECONDS = 30.0
"""Seconds without a step after which the writer thread counts as hanging."""

_COMMAND_SECONDS = 10.0


class Recorder:
    """One recording. Safe to use from any thread.

    Args:
        hub: the node on the hub; it is not closed.
        registry: the known types.
        section: the configuration.
        place: names the files.
        about: metadata of each file.
        changed: called on a thread of zenoh after a change of the graph; it must cause a call of `refresh`.
    """

    def __init__(
        self, hub: Hub, registry: Registry, section: RecordSection, place: RecordPlace, about: dict[str, str],
        changed: Callable[[], None],
    ) -> None:  # fmt: skip
        self.selection = Selection(section)
        self._queue = ArrivalQueue(section.queue << 20)
        self._recorded = RecordedTopics(hub, registry, self.selection, self._queue, changed)
        self._files = FileSeries(place, section, about, hub.graph, self.topics.definitions)
        self._commands: deque[tuple[Future[Any], Callable[[], Any]]] = deque()
        self._ending = False
        self._last_step = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="midspan-record-write", daemon=True)
        self._thread.start()

    @property
    def topics(self) -> HubTopics:
        """The topics on the hub."""
        return self._recorded.topics

    def refresh(self) -> dict[TopicKey, HubTopic]:
        """Subscribe to new selected topics, drop those that left the hub, and return all topics on the hub."""
        return self._recorded.refresh()

    # -- commands ------------------------------------------------------------------------------------------------------

    def begin(self) -> Path | None:
        """Start or continue recording; return the file. Raises `OSError` if it cannot be created, and retries later."""
        self._recorded.start()
        path: Path | None = self._do(self._files.open)
        return path

    def pause(self) -> Path | None:
        """Unsubscribe from all topics, close the file, and return its path; `begin` continues in another file."""
        self._recorded.pause()
        return self.split()

    def split(self) -> Path | None:
        """Close the file and return its path, None if no file is open; the next message starts another file."""
        path: Path | None = self._do(self._files.close)
        return path

    def trigger(self, why: str) -> Future[Path | None]:
        """Start saving the ring's files. The future has their folder, None for an empty ring, or an `OSError`."""
        return self._post(partial(self._files.keep, why))

    def keep(self, why: str) -> Path | None:
        """Save the ring's files, and return their folder, None for an empty ring; raises `OSError`."""
        path: Path | None = self._do(partial(self._files.keep, why))
        return path

    def _post(self, action: Callable[[], Any]) -> Future[Any]:
        future: Future[Any] = Future()
        self._commands.append((future, action))
        self._queue.wake()
        return future

    def _do(self, action: Callable[[], Any]) -> Any:
        """Run an action on the writer thread; raises its error, or `TimeoutError` if the thread does not run it yet."""
        future = self._post(action)
        try:
            return future.result(_COMMAND_SECONDS)
        except TimeoutError:
            if future.done():  # just now, or with an error of the action such as ETIMEDOUT
                return future.result()
            problem = f"the writer thread has not answered for {_COMMAND_SECONDS:g} s, and does this later"
            raise TimeoutError(f"{problem}: is the disk slow or unreachable?") from None

    def close(self) -> None:
        """Write all waiting messages as long as that makes progress, and stop. Safe to call twice."""
        self._recorded.close()
        self._ending = True
        self._queue.wake()
        while self._thread.is_alive() and time.monotonic() - self._last_step < _COMMAND_SECONDS:
            self._thread.join(0.5)

    # -- the writer thread ---------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            # a command applies to the messages that were received before it, so those are written first
            ending, commands = self._ending, len(self._commands)
            waiting = self._queue.pop_all(0.0 if commands or ending else GATHER_SECONDS)
            while waiting:
                self._last_step = time.monotonic()
                arrival = waiting.popleft()
                # else the recording is paused, and the message was received before the pause
                if self._files.file is not None or self._recorded.subscribes or self._ending:
                    self._files.write(arrival)
                self._queue.release(arrival)
            self._run_commands(commands)
            self._files.maintain(recording=self._recorded.subscribes)
            self._last_step = time.monotonic()
            if ending:
                break
        with contextlib.suppress(OSError):
            self._files.close()
        if self._files.ring is not None:
            self._files.ring.discard()

    def _run_commands(self, count: int) -> None:
        for _ in range(count):
            future, action = self._commands.popleft()
            try:
                future.set_result(action())
            except Exception as err:  # the caller gets the error
                _log.debug("a command failed", exc_info=True)
                future.set_exception(err)

    def computes(self) -> None:
        """Raise `RuntimeError` if the writer thread has exited, and `TimeoutError` if it hangs."""
        if not self._thread.is_alive() and not self._ending:
            raise RuntimeError("the writer thread has exited")
        still = time.monotonic() - self._last_step
        if still > STILL_SECONDS:
            raise TimeoutError(f"the writer thread has hung for {still:.0f} s: is the disk unreachable?")

    # -- status --------------------------------------------------------------------------------------------------------

    def status(self) -> RecordingStatus:
        """Return the recording's status."""
        files, file = self._files, self._files.file
        counts = list(self._recorded.counts.values())
        messages, size, dropped = total(counts)
        return RecordingStatus(
            state="blocked" if files.trouble else "recording" if self._recorded.subscribes else "stopped",
            file=str(file.path if file is not None else files.last_path or ""),
            file_bytes=file.safe if file is not None else 0,
            file_messages=file.messages if file is not None else 0,
            files=files.count,
            ring=files.ring is not None,
            messages=messages,
            bytes=size,
            dropped=dropped | self._recorded.lost(),
            error=files.trouble,
            topics=[item.status() for item in counts],
        )

"""The loop of `bridge.adapters.ros2.loop` for systems without eventfd, on rcl's wait set.

It looks at every subscription for every wake: with 500 idle ones about a third of a core at 250 Hz. rclpy's
``get_ready_entities`` makes that as cheap as a wait set can be.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque
from typing import Any

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.loop import TAKES_PER_TURN, Loop, Reader
from bridge.adapters.ros2.participant import Participant

_POLL_NS = 1_000_000_000
_KINDS = ("subscription", "client", "service")

_log = logging.getLogger(__name__)


class WaitSetLoop(Loop):
    """The thread, and the readers that it serves; the same as `TakeLoop`."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._guard = participant.make_guard_condition()
        self._readers: dict[int, Reader] = {}
        self._changes: deque[tuple[Reader, bool]] = deque()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="midspan-ros2-take", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def add(self, reader: Reader) -> None:
        """Serve a reader from now on, what it already holds included."""
        self._change(reader, joins=True)

    def remove(self, reader: Reader) -> None:
        """Stop serving a reader and destroy it, on the loop's thread and soon."""
        self._change(reader, joins=False)

    def _change(self, reader: Reader, *, joins: bool) -> None:
        self._changes.append((reader, joins))
        self._guard.trigger_guard_condition()

    def stop(self) -> None:
        """End the thread and destroy all readers."""
        self._stopping = True
        self._guard.trigger_guard_condition()
        if self._thread.is_alive():
            self._thread.join()
        self._apply_changes()
        for reader in self._readers.values():
            reader.destroy()
        self._readers.clear()
        self._participant.destroy(self._guard)

    def _run(self) -> None:
        taker = rcl.Taker()
        try:
            with self._guard:
                wait_set = self._participant.make_wait_set(1)
                while not self._stopping:
                    if self._apply_changes():
                        kinds = Counter(reader.kind for reader in self._readers.values())
                        wait_set = self._participant.make_wait_set(1, *(kinds[kind] for kind in _KINDS))
                    self._wait(wait_set)
                    for kind in _KINDS:
                        for pointer in wait_set.get_ready_entities(kind):
                            self._serve(pointer, taker)
        finally:
            taker.close()

    def _wait(self, wait_set: Any) -> None:
        wait_set.clear_entities()
        for reader in self._readers.values():
            getattr(wait_set, f"add_{reader.kind}")(reader.handle)
        wait_set.add_guard_condition(self._guard)
        wait_set.wait(_POLL_NS)

    def _serve(self, pointer: int, taker: rcl.Taker) -> None:
        try:
            self._readers[pointer].drain(taker, TAKES_PER_TURN)
        except Exception:
            _log.exception("taking messages failed")

    def _apply_changes(self) -> bool:
        changed = False
        while self._changes:
            reader, joins = self._changes.popleft()
            changed = True
            if joins:
                self._readers[reader.pointer] = reader
            else:
                self._readers.pop(reader.pointer, None)
                reader.destroy()
        return changed

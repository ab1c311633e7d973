"""One thread that receives the messages of all subscriptions, and all requests and replies.

rcl reports new messages to a queue in C, on the middleware's thread and without Python; the thread here waits for the
queue. So the cost of a message does not depend on the number of subscriptions, whereas a wait set and rclpy's executors
check all of them for each message. Without a compiler the wait set remains, for subscriptions.
"""

from __future__ import annotations

import logging
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.participant import Participant
from bridge.hub.lane.joining import Joining
from bridge.routing.edge import Deliver

TAKES_PER_TURN = 32
"""Messages taken from one subscription before the loop serves the others."""

_FAILED_SECONDS = 0.1
"""Pause after a failure to wait for messages, which may repeat at once."""

_log = logging.getLogger(__name__)


Delivers = tuple[Deliver, dict[bytes, str], dict[str, int]]
"""The call that delivers, the ids of publishers by their GIDs, and the last number of each publisher."""


class EndpointReader(ABC):
    """An endpoint that the loop serves: a subscription, unless a class overrides `wake`.

    It holds rclpy's inner object (``handle``) until `destroy`, so that its ``pointer`` (``rcl_subscription_t *`` for a
    subscription) stays valid whichever thread closes it.
    """

    def __init__(self, participant: Participant, handle: Any) -> None:
        self._participant, self.handle = participant, handle
        handle.__enter__()
        self.pointer = int(handle.pointer)

    @property
    def taken_from(self) -> int:
        """The ``rcl_subscription_t *`` of a reader whose messages the queue takes; 0 if `drain` takes them."""
        return 0

    @property
    def delivers(self) -> Delivers | None:
        """How the queue delivers small messages of known publishers instead of `accept`; None: not at all."""
        return None

    def wake(self, waker: rcl.Waker | None) -> None:
        """Report new messages to a waker from now on; with None, stop the reports before returning."""
        rcl.wake("subscription", self.pointer, waker)

    @abstractmethod
    def drain(self, taker: rcl.Taker, limit: int) -> None:
        """Take and deliver up to ``limit`` messages."""

    def accept(self, payload: bytes, gid: bytes, source_ns: int, sequence: int) -> None:
        """Deliver a message that the queue has taken, see `rcl.Taken`."""
        raise NotImplementedError

    def destroy(self) -> None:
        """Release the reader to the middleware, which destroys it; nothing may use it afterwards."""
        self.handle.__exit__(None, None, None)
        self._participant.destroy(self.handle)


class ReadLoop(ABC):
    """A thread, and the readers that it serves.

    Args:
        resolve: see `bridge.adapters.ros2.rcl.Taker`.
    """

    def __init__(self, resolve: Callable[[bytes], bytes] | None = None) -> None:
        self._resolve = resolve
        self._readers: dict[int, EndpointReader] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-ros2-take", daemon=True)

    def start(self) -> None:
        """Start the thread; readers may be added before."""
        self._thread.start()

    @abstractmethod
    def add(self, reader: EndpointReader) -> None:
        """Serve a reader from now on, including messages that it already holds."""

    @abstractmethod
    def remove(self, reader: EndpointReader) -> None:
        """Stop serving a reader, and destroy it soon on the loop's thread."""

    def stop(self) -> None:
        """End the thread and destroy all readers."""
        self._stopping.set()
        self._wake_up()
        if self._thread.is_alive():
            self._thread.join()
        self._close()

    def _run(self) -> None:
        taker = rcl.Taker(self._resolve)
        try:
            self._serve_all(taker)
        finally:
            taker.close()

    @abstractmethod
    def _serve_all(self, taker: rcl.Taker) -> None:
        """Serve the readers until the loop stops."""

    @abstractmethod
    def _wake_up(self) -> None:
        """Wake the thread to apply changes."""

    @abstractmethod
    def _close(self) -> None:
        """Destroy all readers; the thread has ended."""


class QueueReadLoop(ReadLoop):
    """Waits for a queue of readers with new messages, which takes the messages of subscriptions itself (``taking.c``).

    Small messages are joined (`bridge.hub.lane.joining`) until the thread waits again, takes a large message or serves
    another endpoint.
    """

    def __init__(self, resolve: Callable[[bytes], bytes] | None = None) -> None:
        super().__init__(resolve)
        self._queue = rcl.new_queue()
        self._leaving: deque[EndpointReader] = deque()

    @override
    def add(self, reader: EndpointReader) -> None:
        data = self._queue.add(reader, reader.taken_from)
        self._readers[data] = reader
        if reader.delivers is not None and reader.taken_from:
            self._queue.deliver(data, *reader.delivers)
        reader.wake(rcl.queue_waker(data))

    @override
    def remove(self, reader: EndpointReader) -> None:
        self._leaving.append(reader)
        self._wake_up()

    @override
    def _wake_up(self) -> None:
        self._queue.wake()

    @override
    def _close(self) -> None:
        for reader in list(self._readers.values()):
            self._drop(reader)

    @override
    def _serve_all(self, taker: rcl.Taker) -> None:
        joining = Joining()
        try:
            while not self._stopping.is_set():
                try:
                    self._serve(taker, joining)
                except Exception:
                    _log.exception("waiting for messages failed")
                    self._stopping.wait(_FAILED_SECONDS)
        finally:
            joining.end()

    def _serve(self, taker: rcl.Taker, joining: Joining) -> None:
        joining.flush()
        for reader, payload, gid, number, sequence in self._queue.wait():
            try:
                if payload is None:
                    joining.flush()
                    reader.drain(taker, number)
                    continue
                if len(payload) >= rcl.LARGE:
                    joining.flush()
                reader.accept(payload, gid, number, sequence)
            except Exception:
                _log.exception("taking messages failed")
        while self._leaving:
            self._drop(self._leaving.popleft())

    def _drop(self, reader: EndpointReader) -> None:
        data = next((data for data, known in self._readers.copy().items() if known is reader), None)
        if data is not None:
            del self._readers[data]
            try:
                reader.wake(None)
            except rcl.RclError:
                _log.exception("cannot destroy a reader, because rcl may still report its messages")
                return
            self._queue.remove(data)
        reader.destroy()


_POLL_NS = 1_000_000_000


class WaitSetReadLoop(ReadLoop):
    """Waits in rcl's wait set; subscriptions are keyed by their pointers."""

    def __init__(self, participant: Participant) -> None:
        super().__init__(participant.resolve)
        self._participant = participant
        self._guard = participant.make_guard_condition()
        self._changes: deque[tuple[EndpointReader, bool]] = deque()

    @override
    def add(self, reader: EndpointReader) -> None:
        self._changes.append((reader, True))
        self._wake_up()

    @override
    def remove(self, reader: EndpointReader) -> None:
        self._changes.append((reader, False))
        self._wake_up()

    @override
    def _wake_up(self) -> None:
        self._guard.trigger_guard_condition()

    @override
    def _close(self) -> None:
        self._apply_changes()
        for reader in self._readers.values():
            reader.destroy()
        self._readers.clear()
        self._participant.destroy(self._guard)

    @override
    def _serve_all(self, taker: rcl.Taker) -> None:
        with self._guard:
            wait_set = self._participant.make_wait_set(1)
            while not self._stopping.is_set():
                if self._apply_changes():
                    wait_set = self._participant.make_wait_set(1, len(self._readers))
                wait_set.clear_entities()
                for reader in self._readers.values():
                    wait_set.add_subscription(reader.handle)
                wait_set.add_guard_condition(self._guard)
                wait_set.wait(_POLL_NS)
                for pointer in wait_set.get_ready_entities("subscription"):
                    self._serve(pointer, taker)

    def _serve(self, pointer: int, taker: rcl.Taker) -> None:
        try:
            self._readers[pointer].drain(taker, TAKES_PER_TURN)
        except Exception:
            _log.exception("taking messages failed")

    def _apply_changes(self) -> bool:
        changed = False
        while self._changes:
            reader, is_new = self._changes.popleft()
            changed = True
            if is_new:
                self._readers[reader.pointer] = reader
            else:
                self._readers.pop(reader.pointer, None)
                reader.destroy()
        return changed

"""One thread that receives the messages of all subscriptions, and all requests and replies.

rcl counts new messages in an eventfd per endpoint, on the middleware's thread and without Python; the thread here waits
in epoll. So the cost of a message does not depend on the number of subscriptions, whereas a wait set and rclpy's
executors check all of them for each message.
"""

from __future__ import annotations

import logging
import os
import select
import threading
from abc import ABC, abstractmethod
from collections import Counter, deque
from typing import Any, ClassVar

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.participant import Participant
from bridge.hub.lane.joining import Joining

TAKES_PER_TURN = 32
"""Messages taken from one subscription before the loop serves the others."""

_log = logging.getLogger(__name__)


class EndpointReader(ABC):
    """An endpoint that the loop serves; its ``kind`` is subscription, client or service.

    It holds rclpy's inner object (``handle``) until `destroy`, so that its ``pointer`` (``rcl_subscription_t *``, or
    that of its kind) stays valid whichever thread closes it.
    """

    kind: ClassVar[str] = "subscription"
    joins: bool = False
    """Whether serving it takes so little time that earlier messages may wait for it (`bridge.hub.lane.joining`)."""

    def __init__(self, participant: Participant, handle: Any) -> None:
        self._participant, self.handle = participant, handle
        handle.__enter__()
        self.pointer = int(handle.pointer)

    def wake(self, descriptor: int | None) -> None:
        """Count each new message in an eventfd; None stops counting."""
        rcl.wake_by_eventfd(self.kind, self.pointer, descriptor)

    @abstractmethod
    def drain(self, taker: rcl.Taker, limit: int) -> None:
        """Take and deliver up to ``limit`` messages."""

    def destroy(self) -> None:
        """Return the reader to the middleware; nothing may refer to it afterwards."""
        self.handle.__exit__(None, None, None)
        self._participant.destroy(self.handle)


class ReadLoop(ABC):
    """A thread, and the readers that it serves."""

    def __init__(self) -> None:
        self._readers: dict[int, EndpointReader] = {}
        self._stopping = False
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
        self._stopping = True
        self._wake_up()
        if self._thread.is_alive():
            self._thread.join()
        self._close()

    def _run(self) -> None:
        taker = rcl.Taker()
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


class EpollReadLoop(ReadLoop):
    """Waits in epoll, with an eventfd for each reader."""

    def __init__(self) -> None:
        super().__init__()
        self._epoll = select.epoll()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._epoll.register(self._wake, select.EPOLLIN)
        self._leaving: deque[EndpointReader] = deque()

    @override
    def add(self, reader: EndpointReader) -> None:
        """Serve a reader, with a new eventfd."""
        descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._readers[descriptor] = reader
        self._epoll.register(descriptor, select.EPOLLIN)
        reader.wake(descriptor)

    @override
    def remove(self, reader: EndpointReader) -> None:
        self._leaving.append(reader)
        self._wake_up()

    @override
    def _wake_up(self) -> None:
        os.eventfd_write(self._wake, 1)

    @override
    def _close(self) -> None:
        for reader in list(self._readers.values()):
            self._drop(reader)
        self._epoll.close()
        os.close(self._wake)

    @override
    def _serve_all(self, taker: rcl.Taker) -> None:
        joining = Joining()
        while not self._stopping:
            joining.flush()
            for descriptor, _ in self._epoll.poll():
                if descriptor == self._wake:
                    os.eventfd_read(descriptor)
                    while self._leaving:
                        self._drop(self._leaving.popleft())
                else:
                    self._serve(descriptor, taker, joining)

    def _serve(self, descriptor: int, taker: rcl.Taker, joining: Joining) -> None:
        reader = self._readers.get(descriptor)
        if reader is None:
            return
        if not reader.joins:
            joining.flush()
        try:
            count = os.eventfd_read(descriptor)
        except BlockingIOError:
            return
        # take the counted number rather than until the queue is empty: a failed take costs as much as a successful one
        limit = min(count, TAKES_PER_TURN)
        try:
            reader.drain(taker, limit)
        except Exception:
            _log.exception("taking messages failed")
        if count > limit:
            os.eventfd_write(descriptor, count - limit)

    def _drop(self, reader: EndpointReader) -> None:
        for descriptor, known in list(self._readers.items()):
            if known is reader:
                reader.wake(None)
                del self._readers[descriptor]
                self._epoll.unregister(descriptor)
                os.close(descriptor)
                break
        reader.destroy()


_POLL_NS = 1_000_000_000
_KINDS = ("subscription", "client", "service")


class WaitSetReadLoop(ReadLoop):
    """Waits in rcl's wait set; readers are keyed by their pointers."""

    def __init__(self, participant: Participant) -> None:
        super().__init__()
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
            while not self._stopping:
                if self._apply_changes():
                    kinds = Counter(reader.kind for reader in self._readers.values())
                    wait_set = self._participant.make_wait_set(1, *(kinds[kind] for kind in _KINDS))
                wait_set.clear_entities()
                for reader in self._readers.values():
                    getattr(wait_set, f"add_{reader.kind}")(reader.handle)
                wait_set.add_guard_condition(self._guard)
                wait_set.wait(_POLL_NS)
                for kind in _KINDS:
                    for pointer in wait_set.get_ready_entities(kind):
                        self._serve(pointer, taker)

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

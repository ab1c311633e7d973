"""The writing end of a session's lanes: its listener, its readers, and the publishers that they request."""

from __future__ import annotations

import contextlib
import logging
import select
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import RLock, Thread
from typing import Protocol

from bridge.concurrency import SerialExecutor
from bridge.hub.lane import folder
from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.outlet import Outlet, ReaderLink
from bridge.hub.lane.wire import FENCE, FREE, HEAD, MAX_KEY, MAX_KEYS, OFF, ON, fits

_log = logging.getLogger(__name__)
_AGAIN_SECONDS = 0.5


class LanePublisher(Protocol):
    """A publisher that sends on lanes."""

    key: str

    def attach(self, outlet: Outlet) -> None:
        """Send a mark with the last number to the outlet, and then each message."""

    def detach(self, outlet: Outlet) -> None:
        """Stop sending to the outlet."""


class LaneWriter:
    """Accepts the connections of a session's readers, attaches publishers to them, and flushes their queues.

    Args:
        later: calls a function after some seconds.

    Attributes:
        blocks: the session's blocks.

    Raises `OSError` if it cannot listen.
    """

    def __init__(
        self, path: Path, zid: str, blocks: Blocks, later: Callable[[float, Callable[[], None]], None]
    ) -> None:
        self.blocks, self._later = blocks, later
        self._folder, self._zid = path, zid
        self._listener = folder.listen(path, zid)
        self._listener.setblocking(False)
        self._lock = RLock()
        self._publishers: dict[LanePublisher, None] = {}
        self._links: dict[int, ReaderLink] = {}
        self._closed = False
        self._dropped = 0
        self._joins = SerialExecutor("hub-lane-joins")  # a busy publisher may delay a join
        self._joins.submit(lambda: None)  # starts the thread now, since the system may be out of threads later
        self._poll = select.epoll()
        self._poll.register(self._listener, select.EPOLLIN)
        self._listens = True
        self._ends = socket.socketpair()
        self._poll.register(self._ends[0], select.EPOLLIN)
        self._thread = Thread(target=self._run, name="hub-lane-write", daemon=True)
        self._thread.start()

    def add(self, publisher: LanePublisher) -> None:
        """Add a publisher, and attach it to the readers of its key."""
        with self._lock:
            self._publishers[publisher] = None
            for link in tuple(self._links.values()):
                for outlet in link.outlets.values():
                    if fits(outlet.key, publisher.key):
                        publisher.attach(outlet)

    def remove(self, publisher: LanePublisher) -> None:
        """Remove a closed publisher."""
        with self._lock:
            self._publishers.pop(publisher, None)

    @property
    def readers(self) -> int:
        """Number of connected sessions."""
        return len(self._links)

    @property
    def dropped(self) -> int:
        """Total number of dropped messages."""
        return self._dropped + sum(link.dropped for link in tuple(self._links.values()))

    def close(self) -> None:
        """Close all connections. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        folder.remove(self._folder, self._zid)
        self._ends[1].close()
        self._thread.join(2.0)
        self._joins.close()
        self.blocks.close()

    def _run(self) -> None:
        try:
            while not self._closed:
                events = self._poll.poll(None if self._listens else _AGAIN_SECONDS)
                if not self._listens:
                    self._listens = True
                    self._poll.register(self._listener, select.EPOLLIN)
                for number, event in events:
                    try:
                        self._on_event(number, event)
                    except Exception:
                        _log.exception("a reader of the lane is disconnected")
                        self._end(number)
        finally:
            for number in list(self._links):
                self._end(number)
            for end in (*self._ends, self._listener, self._poll):
                end.close()

    def _on_event(self, number: int, event: int) -> None:
        if number == self._listener.fileno():
            self._accept()
            return
        link = self._links.get(number)
        if link is None:
            return
        if event & select.EPOLLOUT:
            link.flush()
        if event & (select.EPOLLHUP | select.EPOLLERR):
            self._end(number)
        elif event & select.EPOLLIN:
            self._read(number, link)

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except BlockingIOError:
            return
        except OSError as err:  # no free descriptor: further readers stay on zenoh
            _log.debug("cannot accept another reader of the lane: %s", err)
            self._poll.unregister(self._listener)
            self._listens = False
            return
        try:
            folder.check_peer(sock)
        except OSError as err:
            _log.warning("a lane is refused: %s", err)
            sock.close()
            return
        sock.setblocking(False)
        number = sock.fileno()
        self._poll.register(number, select.EPOLLIN)
        self._links[number] = ReaderLink(sock, partial(self._watch, number), self.blocks, self._later)

    def _watch(self, number: int, waits: bool) -> None:
        with contextlib.suppress(OSError, ValueError):  # the link has just ended
            self._poll.modify(number, select.EPOLLIN | select.EPOLLOUT if waits else select.EPOLLIN)

    def _read(self, number: int, link: ReaderLink) -> None:
        try:
            record = link.sock.recv(HEAD.size + MAX_KEY)
        except BlockingIOError:
            return
        except OSError:
            record = b""
        if len(record) < HEAD.size:
            self._end(number)
            return
        kind, key = HEAD.unpack_from(record)
        body = record[HEAD.size :]
        if kind == FREE:
            link.on_free(key)
        elif kind == ON:
            self._joins.submit(partial(self._on, link, key, body.decode(errors="replace")))
        elif kind == FENCE:
            self._joins.submit(partial(self._fence, link, key, body))
        elif kind == OFF:
            self._joins.submit(partial(self._off, link, key))

    def _on(self, link: ReaderLink, number: int, key: str) -> None:
        with self._lock:
            outlet = link.outlets.get(number)
            if outlet is None:
                if len(link.outlets) >= MAX_KEYS:
                    return
                outlet = link.outlets[number] = Outlet(link, number, key)
            for publisher in tuple(self._publishers):
                if fits(key, publisher.key):
                    publisher.attach(outlet)

    def _fence(self, link: ReaderLink, number: int, token: bytes) -> None:
        outlet = link.outlets.get(number)
        if outlet is not None:
            outlet.fence(token)

    def _off(self, link: ReaderLink, number: int) -> None:
        with self._lock:
            outlet = link.outlets.pop(number, None)
            if outlet is not None:
                self._detach(outlet)
                link.drop_queue(outlet)

    def _detach(self, outlet: Outlet) -> None:
        for publisher in tuple(self._publishers):
            if fits(outlet.key, publisher.key):
                publisher.detach(outlet)

    def _end(self, number: int) -> None:
        link = self._links.pop(number, None)
        if link is None:
            return
        self._dropped += link.dropped
        with contextlib.suppress(OSError, ValueError):
            self._poll.unregister(number)
        link.close()
        self._joins.submit(partial(self._drop, link))

    def _drop(self, link: ReaderLink) -> None:
        with self._lock:
            for outlet in link.outlets.values():
                self._detach(outlet)
            link.outlets.clear()
        link.sock.close()

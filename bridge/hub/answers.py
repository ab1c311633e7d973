"""Answers to the queries on one key, each given once: a reply or zenoh's error reply."""

from __future__ import annotations

import logging
from functools import partial
from threading import Lock

import zenoh

from bridge.hub.call import Abandon, Call, CallError, Done
from bridge.hub.queries import LEFT, reply_error
from bridge.hub.receiving import keep_thread_state

_log = logging.getLogger(__name__)


class Asked:
    """One request that waits for its reply."""

    def __init__(self, query: zenoh.Query) -> None:
        self.query = query
        self.abandon: Abandon | None = None
        self.left = False


class Answers:
    """Serves one key by a queryable. Safe to use from any thread.

    Args:
        session: who answers.
        key: the key.
        name: the service's, for people.
        limit: bytes of a request or a reply at most.
        call: gets each request.
        complete: whether the queryable says that it has all there is.

    Attributes:
        name: the service's.
    """

    encoding: zenoh.Encoding | None = None

    def __init__(
        self, session: zenoh.Session, key: str, name: str, limit: int, call: Call, *, complete: bool = False
    ) -> None:
        self.name = name
        self._key, self._limit, self._call = key, limit, call
        self._lock = Lock()
        self._waiting: dict[Asked, None] = {}
        self._closed = False
        self._queryable = session.declare_queryable(
            key,
            zenoh.handlers.Callback(self._asked, indirect=False),
            complete=complete,
            allowed_origin=zenoh.Locality.REMOTE,
        )

    def takes(self, query: zenoh.Query) -> bool:  # noqa: ARG002
        """Whether a query is a call at all; it ends without an answer where it is none."""
        return True

    def asked(self, query: zenoh.Query) -> Asked:
        """What is to be known of a query; raises `CallError` where it cannot be taken."""
        return Asked(query)

    def request(self, payload: bytes) -> bytes:
        """The request in the bytes of a query, of none where it has none; raises `CallError`."""
        return payload

    def attached(self, asked: Asked) -> bytes | None:  # noqa: ARG002
        """The attachment of a reply."""
        return None

    def remembered(self, asked: Asked) -> None:
        """A request waits now; called with the lock held."""

    def forgotten(self, asked: Asked) -> None:
        """A request waits no more."""

    def done(self, asked: Asked) -> Done:
        """What takes a request's reply."""
        return partial(self._answer, asked)

    def closing(self) -> None:
        """The server begins to close."""

    def end(self) -> bool:
        """Tell all who wait that the server left, and give the queryable back; whether that was still to do."""
        with self._lock:
            closed, self._closed = self._closed, True
            waiting = list(self._waiting)
        if closed:
            return False
        self.closing()
        for asked in waiting:
            self._leave(asked)
            self._answer(asked, CallError(LEFT.format(name=self.name)))
        self._queryable.undeclare()  # type: ignore[no-untyped-call]
        return True

    def _asked(self, query: zenoh.Query) -> None:
        """Begin a call; runs on zenoh's receiving thread."""
        keep_thread_state()
        if not self.takes(query):
            query.drop()  # type: ignore[no-untyped-call]
            return
        try:
            request = self._read(query)
            asked = self.asked(query)
        except CallError as err:
            reply_error(query, err)
            return
        with self._lock:
            closed = self._closed
            if not closed:
                self._waiting[asked] = None
                self.remembered(asked)
        if closed:
            reply_error(query, CallError(LEFT.format(name=self.name)))
            return
        abandon = self._call(request, self.done(asked))
        with self._lock:
            asked.abandon = abandon
            left = asked.left
        if left:
            abandon()

    def _read(self, query: zenoh.Query) -> bytes:
        payload = query.payload
        if payload is not None and len(payload) > self._limit:
            msg = f"the request has {len(payload)} bytes, limits.message allows {self._limit}"
            raise CallError(msg)
        return self.request(b"" if payload is None else payload.to_bytes())

    def _forget(self, asked: Asked) -> bool:
        """Whether the request was still waiting."""
        with self._lock:
            waited = asked in self._waiting
            self._waiting.pop(asked, None)
        if waited:
            self.forgotten(asked)
        return waited

    def _answer(self, asked: Asked, result: bytes | CallError) -> None:
        if not self._forget(asked):
            return
        if isinstance(result, bytes) and len(result) > self._limit:
            result = CallError(f"the reply has {len(result)} bytes, limits.message allows {self._limit}")
        if isinstance(result, CallError):
            reply_error(asked.query, result)
            return
        try:
            with asked.query as query:
                query.reply(self._key, result, encoding=self.encoding, attachment=self.attached(asked))
        except zenoh.ZError as err:
            _log.debug("%s: nobody waits for the reply any more: %s", self.name, err)

    def abandoned(self, asked: Asked) -> None:
        """A caller is gone."""
        if self._forget(asked):
            asked.query.drop()  # type: ignore[no-untyped-call]
            self._leave(asked)

    def _leave(self, asked: Asked) -> None:
        with self._lock:
            asked.left = True
            abandon = asked.abandon
        if abandon is not None:
            abandon()

"""Plain zenoh keys below one prefix: values with timestamps, queries and liveliness tokens.

zenoh replaces the timestamp of a sample that is more than half a second ahead of the receiver's clock (measured with
zenoh 1.10; its hybrid logical clock refuses to follow). Writers whose exact time matters also send it in the
attachment.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import zenoh

from bridge.hub.errors import HubClosedError, HubError, zenoh_reason
from bridge.hub.opening import prepare_to_send
from bridge.hub.zenoh_compat import BEHIND, answer, follow_tokens, keep_thread_state, source_infos, subscribe, undeclare

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class KeyItem:
    """A value under a key, or its deletion.

    Attributes:
        body: the value; None if it was deleted.
        ns: the time at which the value was written or deleted, in nanoseconds since 1970; 0 if unknown.
        writer: id of the clock from which the time comes, up to 16 bytes in hexadecimal.
    """

    key: str
    body: bytes | None
    encoding: str = ""
    ns: int = 0
    writer: str = ""
    attachment: bytes = b""


class KeyQuery:
    """A pending query. The receiver must end it; any thread may do so.

    Attributes:
        key: the requested key below the prefix; it may have wildcards.
    """

    def __init__(self, query: zenoh.Query, prefix: str) -> None:
        self._query, self._prefix = query, prefix
        self.key = str(query.key_expr).removeprefix(f"{prefix}/")
        self.body = b"" if query.payload is None else query.payload.to_bytes()

    def asks_for(self, key: str) -> bool:
        """Return whether the query matches a key below the prefix."""
        return bool(self._query.key_expr.intersects(zenoh.KeyExpr(f"{self._prefix}/{key}")))

    def reply(self, item: KeyItem) -> None:
        """Send a value or a deletion; a query may get several replies."""
        stamp = _timestamp(item)
        key, attachment = f"{self._prefix}/{item.key}", item.attachment or None
        prepare_to_send(len(item.body or b""))
        with self._nobody_waits():
            if item.body is None:
                self._query.reply_del(key, timestamp=stamp, attachment=attachment)
            else:
                encoding = item.encoding or None
                self._query.reply(key, item.body, encoding=encoding, timestamp=stamp, attachment=attachment)

    def fail(self, why: str) -> None:
        """Reply with an error."""
        with self._nobody_waits():
            self._query.reply_err(why.encode())

    def end(self) -> None:
        """End the replies."""
        with self._nobody_waits():
            self._query.drop()  # type: ignore[no-untyped-call]

    @contextlib.contextmanager
    def _nobody_waits(self) -> Iterator[None]:
        try:
            yield
        except zenoh.ZError as err:
            _log.debug("the client of %s has left: %s", self.key, err)


class KeySpace:
    """The keys below a prefix as one session sees and serves them. Safe to use from any thread.

    Callbacks run on zenoh's receiving thread, so they must only queue work and wake another thread. A session does not
    receive the values and queries that it sends itself.

    Args:
        limit: maximum size in bytes of a received value or query; larger ones are dropped.
    """

    def __init__(self, session: zenoh.Session, prefix: str, limit: int) -> None:
        self._session, self._prefix, self._limit = session, prefix, limit
        self._lock, self._sending = threading.Lock(), threading.Lock()
        self._infos: Iterator[zenoh.SourceInfo] | None = None
        self._ends: list[Any] = []
        self._asking: set[zenoh.CancellationToken] = set()
        self._closed = False

    def send(self, item: KeyItem) -> None:
        """Publish a written value or a deletion; blocks while a link is full. Raises `HubError` if zenoh fails."""
        key, stamp, attachment = f"{self._prefix}/{item.key}", _timestamp(item), item.attachment or None
        options: Any = {
            "timestamp": stamp,
            "attachment": attachment,
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "priority": BEHIND,
            "allowed_destination": zenoh.Locality.REMOTE,
        }
        prepare_to_send(len(item.body or b""))
        try:
            # Without source numbers zenoh's advanced subscriber compares timestamps, and drops a value that is older
            # than the last value of the same writer, even under another key.
            with self._sending:
                if self._infos is None:
                    self._infos = self._numbers()
                options["source_info"] = next(self._infos)
                if item.body is None:
                    self._session.delete(key, **options)
                else:
                    self._session.put(key, item.body, encoding=item.encoding or None, **options)
        except zenoh.ZError as err:
            raise HubError(f"cannot send {item.key}: {zenoh_reason(err)}") from None

    def _numbers(self) -> Iterator[zenoh.SourceInfo]:
        source = self._session.declare_publisher(self._prefix, allowed_destination=zenoh.Locality.REMOTE)
        self._keep(source)
        return source_infos(source)

    def subscribe(self, keys: str, callback: Callable[[KeyItem], None]) -> None:
        """Call ``callback`` for each value that is written or deleted, until the space is closed."""

        def on_message(sample: zenoh.Sample) -> None:
            keep_thread_state()
            item = self._item(sample)
            if item is not None:
                callback(item)

        self._keep(subscribe(self._session, f"{self._prefix}/{keys}", on_message))

    def serve(self, keys: str, asked: Callable[[KeyQuery], None], *, complete: bool = False) -> None:
        """Answer queries for ``keys``, which may have wildcards, until the space is closed.

        With ``complete``, zenoh may query only one of several such servers, because each has all values.
        """

        def on_message(query: zenoh.Query) -> None:
            keep_thread_state()
            if query.payload is not None and len(query.payload) > self._limit:
                query.drop()  # type: ignore[no-untyped-call]
            else:
                asked(KeyQuery(query, self._prefix))

        self._keep(answer(self._session, f"{self._prefix}/{keys}", on_message, complete=complete))

    def ask(self, keys: str, body: bytes = b"", seconds: float = 5.0) -> list[KeyItem]:
        """Query all servers of ``keys``; return when all have replied, or after ``seconds``.

        Raises:
            HubError: a server replied with an error, or zenoh could not send the query.
            HubClosedError: the space was closed.
        """
        token = zenoh.CancellationToken()
        with self._lock:
            if self._closed:
                raise HubClosedError("the hub session is closed")
            self._asking.add(token)
        try:
            replies: Any = self._session.get(
                f"{self._prefix}/{keys}",
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=seconds,
                priority=BEHIND,
                payload=body,
                allowed_destination=zenoh.Locality.REMOTE,
                cancellation_token=token,
            )
            return list(self._items(replies))
        except zenoh.ZError as err:
            raise HubError(f"cannot query {keys}: {zenoh_reason(err)}") from None
        finally:
            with self._lock:
                self._asking.discard(token)

    def announce(self, key: str) -> None:
        """Declare a liveliness token, which exists until the space is closed."""
        self._keep(self._session.liveliness().declare_token(f"{self._prefix}/{key}"))

    def tokens(self, keys: str, seconds: float = 2.0) -> list[str]:
        """Return the current tokens of keys; use it only for keys that this session does not watch.

        For watched keys, zenoh 1.10 lists only tokens that the session has received, and sometimes misses the newest.
        """
        replies: Any = self._session.liveliness().get(f"{self._prefix}/{keys}", timeout=seconds)
        return [self._below(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None]

    def watch(self, keys: str, changed: Callable[[str, bool], None]) -> None:
        """Call ``changed`` for each existing or new token (True) or removed token (False), until the space closes."""

        def on_message(sample: zenoh.Sample) -> None:
            keep_thread_state()
            changed(self._below(str(sample.key_expr)), sample.kind == zenoh.SampleKind.PUT)

        self._keep(follow_tokens(self._session, f"{self._prefix}/{keys}", on_message))

    def close(self) -> None:
        """Withdraw everything, and end pending queries. Safe to call twice."""
        with self._lock:
            self._closed = True
            ends, self._ends = self._ends, []
            asking = list(self._asking)
        for token in asking:
            token.cancel()  # type: ignore[no-untyped-call]
        undeclare(*reversed(ends))

    def _keep(self, end: Any) -> None:
        with self._lock:
            if not self._closed:
                self._ends.append(end)
                return
        end.undeclare()

    def _items(self, replies: Any) -> Iterator[KeyItem]:
        for reply in replies:
            if reply.ok is None:
                raise HubError(reply.err.payload.to_bytes()[:1000].decode(errors="replace"))
            item = self._item(reply.ok)
            if item is not None:
                yield item

    def _item(self, sample: zenoh.Sample) -> KeyItem | None:
        key = self._below(str(sample.key_expr))
        if len(sample.payload) > self._limit:
            _log.warning("%s: value of %d bytes dropped, the limit is %d", key[:100], len(sample.payload), self._limit)
            return None
        ns, writer = 0, ""
        if sample.timestamp is not None:
            ns = sample.timestamp.get_time_as_ntp64().as_nanos()
            writer = bytes(sample.timestamp.get_id()).hex()
        body = sample.payload.to_bytes() if sample.kind == zenoh.SampleKind.PUT else None
        attachment = b"" if sample.attachment is None else sample.attachment.to_bytes()
        return KeyItem(key, body, str(sample.encoding), ns, writer, attachment)

    def _below(self, key: str) -> str:
        return key.removeprefix(f"{self._prefix}/")


def _timestamp(item: KeyItem) -> zenoh.Timestamp | None:
    if not item.ns:
        return None
    seconds, nanoseconds = divmod(item.ns, 1_000_000_000)
    return zenoh.Timestamp(zenoh.NTP64(seconds, nanoseconds), bytes.fromhex(item.writer))

"""How a latched subscription gets what latched publishers keep.

The publishers are zenoh's advanced publishers, as rmw_zenoh makes them: each has a token at
``<key>/@adv/pub/<zid>/<entity>/...``, answers queries there with the last samples that it keeps, and tells there, half
a second after a change, the number of its last sample.

zenoh's own advanced subscriber asks each publisher twice at the start, and where the answers cross, it leaves out the
older part of a history of more than one sample. Here each publisher is asked once, and what its session says meanwhile
is held back until the answer is complete.
"""

from __future__ import annotations

import contextlib
import logging
from functools import partial
from threading import Lock
from typing import Protocol

import zenoh

from bridge.hub.errands import Errands

_log = logging.getLogger(__name__)

ANSWER_SECONDS = 10.0
"""How long a publisher may take to answer; what its session says is held back for so long."""

_PUBLISHERS = "/@adv/pub/"
_NUMBERS = 1 << 32
_MAX_PUBLISHERS = 4096


class Listener(Protocol):
    """What hears of the history; called on zenoh's threads."""

    def asked(self, zid: str) -> None:
        """A session's publishers were asked: hold back what it says."""

    def came(self, sample: zenoh.Sample) -> None:
        """One of the samples that were asked for."""

    def done(self, zid: str) -> None:
        """All that was asked for has come, or never will."""


class History:
    """Asks the publishers of one key, those that are there and those that come, once `open` was called.

    With ``recovers`` it asks again where a publisher's last sample did not come. ``depth`` is how many samples each of
    them is asked for; it may be changed later.

    It asks by ``errands``: a query waits where the link is congested, and zenoh's receiving thread, which tells of the
    publishers, must go on reading. Two peers that both waited so for the other to read would do it for five seconds,
    and then lose their link.
    """

    def __init__(
        self, session: zenoh.Session, key: str, depth: int, listener: Listener, errands: Errands, *, recovers: bool
    ) -> None:
        self._session = session
        self._errands = errands
        self._closed = False
        self._key = key
        self._samples = zenoh.KeyExpr(key)
        self.depth = depth
        self._listener = listener
        self._recovers = recovers
        self._lock = Lock()
        self._numbers: dict[tuple[str, str], int] = {}
        self._subscribers: list[zenoh.Subscriber[None]] = []

    def open(self) -> None:
        """Begin; the live samples must be subscribed to before."""
        space = f"{self._key}{_PUBLISHERS}**"
        session = self._session
        self._subscribers = [
            session.liveliness().declare_subscriber(
                space, zenoh.handlers.Callback(self._on_token, indirect=False), history=True
            )
        ]
        if self._recovers:
            self._subscribers.append(
                session.declare_subscriber(
                    space,
                    zenoh.handlers.Callback(self._on_heartbeat, indirect=False),
                    allowed_origin=zenoh.Locality.REMOTE,
                )
            )

    def saw(self, info: zenoh.SourceInfo | None) -> None:
        """Remember the number of the newest sample of a publisher."""
        if info is None:
            return
        identity = info.source_id
        publisher = str(identity.zid), str(identity.eid)
        with self._lock:
            if _newer(info.source_sn, self._numbers.get(publisher)):
                if len(self._numbers) >= _MAX_PUBLISHERS:
                    del self._numbers[next(iter(self._numbers))]
                self._numbers[publisher] = info.source_sn

    def ask(self, publishers: str, zid: str) -> None:
        """Ask the publishers at a key for what they keep. Not to be called with a lock held that the listener needs."""
        self._listener.asked(zid)
        self._errands.send(partial(self._ask, publishers, zid))

    def _ask(self, publishers: str, zid: str) -> None:
        if self._closed:
            return
        try:
            self._session.get(
                f"{publishers}?_max={self.depth}",
                zenoh.handlers.Callback(self._on_reply, lambda: self._listener.done(zid), indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
                timeout=ANSWER_SECONDS,
                allowed_destination=zenoh.Locality.REMOTE,
            )
        except zenoh.ZError:
            # the session is being closed
            self._listener.done(zid)

    def ask_session(self, zid: str) -> None:
        """Ask all publishers of a session, after a gap in what one of them said."""
        self.ask(f"{self._key}{_PUBLISHERS}{zid}/**", zid)

    def close(self) -> None:
        """Ask no more. Safe to call twice."""
        self._closed = True
        for subscriber in self._subscribers:
            with contextlib.suppress(zenoh.ZError):
                subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._subscribers = []

    def _on_token(self, token: zenoh.Sample) -> None:
        publisher = _publisher(token)
        if publisher is None:
            return
        if token.kind == zenoh.SampleKind.DELETE:
            with self._lock:
                self._numbers.pop(publisher, None)
        else:
            self.ask(str(token.key_expr), publisher[0])

    def _on_heartbeat(self, sample: zenoh.Sample) -> None:
        publisher = _publisher(sample)
        number = int.from_bytes(sample.payload.to_bytes()[:4], "little")
        if publisher is None:
            return
        with self._lock:
            seen = self._numbers.get(publisher)
        if _newer(number, seen):
            self.ask(str(sample.key_expr), publisher[0])

    def _on_reply(self, reply: zenoh.Reply) -> None:
        # what is asked is not on the samples' key: whoever answers could say anything on any key that it may write
        if reply.ok is not None and self._samples.includes(reply.ok.key_expr):
            self._listener.came(reply.ok)


def _newer(number: int, seen: int | None) -> bool:
    """Numbers of 32 bits, which begin anew after the last."""
    return seen is None or 0 < (number - seen) % _NUMBERS < _NUMBERS // 2


def _publisher(sample: zenoh.Sample) -> tuple[str, str] | None:
    """Session and entity that a token or a heartbeat is about."""
    parts = str(sample.key_expr).rpartition(_PUBLISHERS)[2].split("/")
    return (parts[0], parts[1]) if len(parts) > 1 else None

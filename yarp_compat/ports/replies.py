"""Seeing where a reply ends while it comes."""

from __future__ import annotations

from collections.abc import Callable

from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.errors import Incomplete
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reply import ReplyReader, plain_end

ReplyEnd = Callable[[Buffer], int]
"""Where a reply ends that stands at the beginning of these bytes; raises Incomplete when more must come."""
_LONG = 1 << 16


class ReplyWatch:
    """Looks at one reply.

    Args:
        parse: where it ends; None: where the Bottle does, or with a text carrier the line.
        carrier: how it comes.
        profile: the peer's dialect, where it is known; afterwards, where the reply told it.
        limit: bytes of the largest reply.
    """

    __slots__ = ("_carrier", "_limit", "_next_look", "_parse", "_reader", "profile")

    def __init__(self, parse: ReplyEnd | None, carrier: Carrier, profile: Profile | None, limit: int) -> None:
        self.profile = profile
        self._carrier = carrier
        self._limit = limit
        self._parse = parse or (_line_end if carrier.text else None)
        self._reader: ReplyReader | None = None
        self._next_look = 1

    def end(self, came: Buffer) -> int:
        """Where the reply ends; 0 where more must come.

        Raises:
            WireError: it is none.
        """
        if len(came) < self._next_look:
            return 0
        try:
            if self._parse is not None:
                return self._parse(came)
            end = plain_end(came, self.profile)
            if 0 < end <= len(came):
                return end
            reader = self._reader
            if reader is None:
                reader = self._reader = ReplyReader(self.profile, acked=self._carrier.ack, limit=self._limit)
            end = reader.end(came)
            self.profile = reader.profile
        except Incomplete:
            # a caller's parser begins anew each time: a long reply is looked at again when it has grown by half
            self._next_look = len(came) + len(came) // 2 if self._parse is not None and len(came) > _LONG else 1
            return 0
        return end

    def pause(self) -> None:
        """Nothing came for a while: perhaps it is all there."""
        self._next_look = 1


def _line_end(came: Buffer) -> int:
    found = bytes(came).find(b"\n")
    if found < 0:
        raise Incomplete("a line ends early")
    return found + 1

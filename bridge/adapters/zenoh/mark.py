"""The mark by which what Midspan made on a zenoh network is known at once: the end of its sessions' ids.

A session's id stands in the liveliness tokens of its endpoints, in the source info of each sample that Midspan sends,
and in the time stamps that the session gives. Native sessions have random ids.
"""

from __future__ import annotations

import secrets

import zenoh

MARK = "6d7370616e7a"
"""Last twelve hex digits of a marked id."""

_DIGITS = 32


def new_zid() -> str:
    """A random session id that carries the mark; zenoh takes up to 32 hex digits, the first not 0."""
    return secrets.choice("123456789abcdef") + secrets.token_hex(_DIGITS // 2)[: _DIGITS - 1 - len(MARK)] + MARK


def is_marked(zid: str) -> bool:
    """Whether a session is Midspan's."""
    return len(zid) == _DIGITS and zid.endswith(MARK)


def sender(sample: zenoh.Sample) -> str:
    """The session that a sample says it is from, "" where it says nothing.

    Without source info it is the session that gave the time stamp, which may be a router on the way.
    """
    info = sample.source_info
    if info is not None:
        return str(info.source_id.zid)
    stamp = sample.timestamp
    return "" if stamp is None else str(stamp.get_id())


def time_ns(sample: zenoh.Sample) -> int | None:
    """A sample's time stamp in nanoseconds of system time; set by its source, or by the first router on its way."""
    stamp = sample.timestamp
    return None if stamp is None else int(stamp.get_time_as_ntp64().as_nanos())

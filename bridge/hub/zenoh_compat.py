"""Declarations on zenoh as all of Midspan makes them, and the Python state of zenoh's threads.

Callbacks run on zenoh's receiving thread (``indirect=False``), so they may only append and wake. Samples from the same
session, if ``origin`` includes it, arrive on the thread that puts them.

A callback at the end of a query must not use zenoh, but submit to an executor. For queries to a lost session, zenoh
runs this callback while it holds a lock that every query needs (1.10: ``finalize_pending_queries``). Another thread's
query then waits for that lock while it reads the routing tables, and a third thread's declaration waits to write them.
A callback that uses zenoh would wait for the declaration, and the session would hang forever.
"""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections.abc import Callable, Iterator
from typing import Any

import zenoh

BEHIND = zenoh.Priority.DATA_LOW
"""The priority of large samples, and of samples that wait for a full link; it has a separate queue, served last.

While such a sample is put into a link's queue, all other samples for that queue wait, from any node of the session. A
reply has the priority of its query.
"""

_thread = threading.local()


def keep_thread_state() -> None:
    """Keep this thread's Python state after the current callback from zenoh; each callback calls this.

    Otherwise CPython creates a state for each call on such a thread, maps a page of stack for it, and unmaps it
    afterwards, which costs 20 us per message and a flush of the other core's address cache.
    """
    if not hasattr(_thread, "kept"):  # stored in the state itself, because thread ids are reused
        _thread.kept = True
        ctypes.pythonapi.PyGILState_Ensure()


def subscribe(
    session: zenoh.Session,
    key: str,
    callback: Callable[[zenoh.Sample], None],
    origin: zenoh.Locality = zenoh.Locality.REMOTE,
) -> zenoh.Subscriber[None]:
    """Call ``callback`` for each sample on a key, by default only for samples from other sessions."""
    handler = zenoh.handlers.Callback(callback, indirect=False)
    return session.declare_subscriber(key, handler, allowed_origin=origin)


def answer(
    session: zenoh.Session,
    key: str,
    callback: Callable[[zenoh.Query], None],
    *,
    complete: bool = False,
    origin: zenoh.Locality = zenoh.Locality.REMOTE,
) -> zenoh.Queryable[None]:
    """Call ``callback`` for each query on a key, by default from other sessions, optionally as a complete queryable."""
    handler = zenoh.handlers.Callback(callback, indirect=False)
    return session.declare_queryable(key, handler, complete=complete, allowed_origin=origin)


def follow_tokens(session: zenoh.Session, keys: str, callback: Callable[[zenoh.Sample], None]) -> Any:
    """Call ``callback`` for each liveliness token that exists, appears or disappears."""
    handler = zenoh.handlers.Callback(callback, indirect=False)
    return session.liveliness().declare_subscriber(keys, handler, history=True)


SOURCE_NUMBERS = 1 << 32
"""Number of source numbers; after the highest, 0 follows."""


def source_infos(publisher: zenoh.Publisher, first: int = 0) -> Iterator[zenoh.SourceInfo]:
    """Yield the source info of each sample that a publisher puts: its id, and a number that grows by one per sample.

    Every subscription of rmw_zenoh is an advanced subscriber of zenoh, which drops a sample whose number is not higher
    than the last one from the same id, and counts a missing number as a lost sample. The caller puts one sample per
    source info, in order.
    """
    identity, number = publisher.id, first
    while True:
        yield zenoh.SourceInfo(identity, number)
        number = (number + 1) % SOURCE_NUMBERS


def undeclare(*ends: Any) -> None:
    """Undeclare declarations; do nothing if the session is closed."""
    for end in ends:
        with contextlib.suppress(zenoh.ZError):
            end.undeclare()

"""Declarations on zenoh in the form that all of Midspan uses, and the Python state of zenoh threads.

Callbacks run on zenoh's receiving thread (``indirect=False``): they append and wake. Samples of the same session arrive
on the thread that puts them, if ``origin`` includes the session.

A callback at the end of a query must not use zenoh; it submits to an executor. For the queries to a lost session zenoh
runs it while it holds a lock that every query needs (1.10: ``finalize_pending_queries``). Another thread's query then
waits for that lock while it reads the routing tables, and a third thread's declaration waits to write them. A callback
that uses zenoh waits behind the declaration: the session hangs for ever.
"""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections.abc import Callable, Iterator
from typing import Any

import zenoh

BEHIND = zenoh.Priority.DATA_LOW
"""The priority of large samples, and of samples that wait for a full link: a separate queue, served last.

While such a sample is put into a link's queue, all other samples for that queue wait, from any node of the session. A
reply has the priority of its query.
"""

_thread = threading.local()


def keep_thread_state() -> None:
    """Keep this thread's Python state after the current callback from zenoh; each callback calls this.

    For each call on such a thread CPython creates a state, maps a page of stack for it, and unmaps it afterwards: 20 us
    a message, and a flush of the other core's address cache.
    """
    if not hasattr(_thread, "kept"):  # stored in the state itself, since thread ids are reused
        _thread.kept = True
        ctypes.pythonapi.PyGILState_Ensure()


def subscribe(
    session: zenoh.Session,
    key: str,
    callback: Callable[[zenoh.Sample], None],
    origin: zenoh.Locality = zenoh.Locality.REMOTE,
) -> zenoh.Subscriber[None]:
    """Call back for each sample on a key, by default of other sessions only."""
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
    """Call back for each query on a key, by default of other sessions; ``complete``: it has all values."""
    handler = zenoh.handlers.Callback(callback, indirect=False)
    return session.declare_queryable(key, handler, complete=complete, allowed_origin=origin)


def follow_tokens(session: zenoh.Session, keys: str, callback: Callable[[zenoh.Sample], None]) -> Any:
    """Call back for each liveliness token that exists, appears or disappears."""
    handler = zenoh.handlers.Callback(callback, indirect=False)
    return session.liveliness().declare_subscriber(keys, handler, history=True)


SOURCE_NUMBERS = 1 << 32
"""Number of source numbers; 0 follows the highest."""


def source_infos(publisher: zenoh.Publisher, first: int = 0) -> Iterator[zenoh.SourceInfo]:
    """Yield the source info of each sample that a publisher puts: its id, and a number that grows by one per sample.

    Every subscription of rmw_zenoh is zenoh's advanced subscriber, which drops a sample whose number is not above the
    last one from the same id. A number that is left out counts as a lost sample there. The caller puts one sample per
    source info, in order.
    """
    identity, number = publisher.id, first
    while True:
        yield zenoh.SourceInfo(identity, number)
        number = (number + 1) % SOURCE_NUMBERS


def undeclare(*ends: Any) -> None:
    """Undeclare; does nothing if the session is closed."""
    for end in ends:
        with contextlib.suppress(zenoh.ZError):
            end.undeclare()

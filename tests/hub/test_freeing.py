"""Closed routers are freed while zenoh's thread `net` calls Python, and no other thread has to wait for that."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event

import zenoh

from bridge.hub import freeing
from bridge.hub.freeing import free
from bridge.hub.opening import open_session
from bridge.hub.panics import failure
from bridge.hub.zenoh_config import make_config, router_tree, session_tree
from tests.support.ports import free_port

WAIT = 10.0
"""Seconds for which zenoh waits for its task; see the module's docstring."""


def open_router() -> zenoh.Session:
    return open_session(make_config(router_tree([f"tcp/127.0.0.1:{free_port()}"], max_payload=1 << 20), None))


@contextmanager
def net_busy() -> Iterator[None]:
    """Block zenoh's thread `net` in a matching listener until the end of the context, or for longer than `WAIT`."""
    entered, ends = Event(), Event()

    def listener(_status: object) -> None:
        entered.set()
        ends.wait(WAIT + 2)

    with zenoh.open(make_config(session_tree(None, shared_memory=False, max_payload=1 << 20), None)) as session:
        publisher = session.declare_publisher("x")
        publisher.declare_matching_listener(zenoh.handlers.Callback(listener, indirect=False))
        session.declare_subscriber("x", lambda _sample: None)
        assert entered.wait(20)
        try:
            yield
        finally:
            ends.set()


def test_dropping_the_last_reference_to_a_router_does_not_wait() -> None:
    router = open_router()
    router.close()  # type: ignore[no-untyped-call]
    with net_busy():
        before = time.monotonic()
        del router
        failure()  # forgets closed sessions
        assert time.monotonic() - before < WAIT / 2


def kept() -> int:
    """Return the number of kept routers, without those to which only garbage or the check for panics refers."""
    gc.collect()
    failure()
    free()
    return len(freeing._routers)


def test_closed_routers_are_freed() -> None:
    before = kept()
    for _ in range(3):
        router = open_router()
        assert kept() == before + 1
        router.close()  # type: ignore[no-untyped-call]
        del router
    assert kept() == before


def test_router_in_use_stays_open() -> None:
    router = open_router()
    free()
    assert not router.is_closed()
    router.close()  # type: ignore[no-untyped-call]

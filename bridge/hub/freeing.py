"""Frees zenoh sessions in router mode without stopping all Python threads of the process.

When the last reference to such a session is dropped, zenoh 1.10 waits for up to 10 s until a task on its thread ``net``
has ended (``TreesComputationWorker`` in ``hat/router/mod.rs``), and the destructor of ``zenoh.Session`` holds the
interpreter's lock meanwhile. If the thread is calling Python, for example a matching listener, it waits for that lock:
all threads of the process stand still for 10 s, and its links expire. The garbage collector may drop the reference at
any time, on any thread. Subscribers refer to their session, too, and their destructor releases the lock, so one is
dropped after the session.
"""

from __future__ import annotations

import atexit
import sys
from collections.abc import Sequence
from threading import Lock

import zenoh

from bridge.hub.zenoh_compat import subscribe

_lock = Lock()
_routers: list[tuple[zenoh.Session, zenoh.Subscriber[None]]] = []


def _references(pairs: Sequence[tuple[object, object]], index: int) -> int:
    """Return the number of references to a pair's first object, including those that exist during this call."""
    return sys.getrefcount(pairs[index][0])


_ONLY_HERE = _references([(object(), None)], 0)


def keep(router: zenoh.Session) -> zenoh.Session:
    """Let a router live until `free` frees it, and return it; the user closes it as usual."""
    free()
    keeper = subscribe(router, "@midspan/keeps", lambda _sample: None, zenoh.Locality.SESSION_LOCAL)
    with _lock:
        _routers.append((router, keeper))
    return router


def free() -> None:
    """Close and free the routers to which nothing else refers; called before each new router, and at exit."""
    with _lock:
        unused = [i for i in range(len(_routers)) if _references(_routers, i) == _ONLY_HERE]
        taken = [_routers.pop(i) for i in reversed(unused)]
    while taken:
        router, keeper = taken.pop()
        router.close()  # type: ignore[no-untyped-call]
        del router
        del keeper


atexit.register(free)

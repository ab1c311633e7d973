"""A worker connects to the other workers on its YARP network."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.yarp import presence
from bridge.adapters.yarp.network import PRESENCE
from bridge.adapters.yarp.presence import WorkerPresence
from bridge.messages.registry import Registry
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.wire.contact import ConnectionRoute, PortContact

DEAD = f"{PRESENCE}dead"
CONTACTS = {DEAD: PortContact(DEAD, "127.0.0.1", 10002)}


def make_workers(add_output: Callable[[str], tuple[bool, str]]) -> WorkerPresence:
    """Return the presence of a worker that connects to others with ``add_output``."""
    naming = NameClient(Address("127.0.0.1", 1), namespace="/root")
    context: Any = SimpleNamespace(
        owner="me", daemon="d", naming=naming, registry=Registry(), changed=lambda: None, ip="127.0.0.1"
    )
    workers = WorkerPresence(context, lambda: None)
    core: Any = SimpleNamespace(name=f"{PRESENCE}me", is_open=False, outputs=list, inputs=list, add_output=add_output)
    workers._core = core
    return workers


def test_attempts_to_connect_to_a_dead_worker_become_rarer(monkeypatch: pytest.MonkeyPatch) -> None:
    now, tried = 100.0, []
    monkeypatch.setattr(presence, "time", SimpleNamespace(monotonic=lambda: now))
    monkeypatch.setattr(connections, "responds", lambda *_, **__: True)
    workers = make_workers(lambda _name: (tried.append(now - 100.0), (False, ""))[1])
    for _ in range(60):
        workers.connect(CONTACTS, now)
        now += 1.0
    assert tried == [0.0, 2.0, 6.0, 14.0, 30.0, 46.0]
    workers._on_event(
        ConnectionEvent(ConnectionRoute(DEAD, f"{PRESENCE}me", "tcp"), up=True, incoming=True)
    )  # the other worker is alive after all
    workers.connect(CONTACTS, now)
    assert tried[-1] == 60.0


def test_worker_whose_machine_has_left_is_only_queried(monkeypatch: pytest.MonkeyPatch) -> None:
    """An attempt to connect would delay the thread that manages all ports for five seconds."""
    queried, tried = list[PortContact](), list[str]()
    monkeypatch.setattr(connections, "responds", lambda contact, **_: (queried.append(contact), False)[1])
    workers = make_workers(lambda name: (tried.append(name), (True, ""))[1])
    workers.connect(CONTACTS, 0.0)
    assert (queried, tried) == ([CONTACTS[DEAD]], [])
    assert workers.sightings() == []


def test_other_workers_count_as_alive_after_this_worker_was_suspended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their records are still in this worker's sockets; it must not take over the names of their ports."""
    now = 100.0
    monkeypatch.setattr(presence, "time", SimpleNamespace(monotonic=lambda: now))
    workers = make_workers(lambda _name: (True, ""))

    def run(seconds: float, *, other: bool) -> None:
        """Send records, and receive those of the other worker if it runs."""
        nonlocal now
        for _ in range(round(seconds / 0.2)):
            now += 0.2
            workers.announce(b"mine")
            if other:
                workers._record(f"{PRESENCE}other", b"theirs")

    run(2.0, other=True)
    assert workers.is_alive("other")
    assert not workers.is_alive("unknown")
    now += 5.0  # this worker is suspended
    assert workers.is_alive("other")
    run(0.2, other=False)
    assert workers.is_alive("other")
    run(2.0, other=False)
    assert not workers.is_alive("other")

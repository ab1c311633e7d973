"""A worker connects to the other workers on its YARP network."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.yarp import presence
from bridge.adapters.yarp.network import PRESENCE
from bridge.adapters.yarp.presence import WorkerPresence
from bridge.messages.registry import Registry
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.wire.contact import ConnectionRoute, PortContact


def test_attempts_to_connect_to_a_dead_worker_become_rarer(monkeypatch: pytest.MonkeyPatch) -> None:
    now, tried = 100.0, []
    monkeypatch.setattr(presence, "time", SimpleNamespace(monotonic=lambda: now))
    naming = NameClient(Address("127.0.0.1", 1), namespace="/root")
    context: Any = SimpleNamespace(
        owner="me", daemon="d", naming=naming, registry=Registry(), changed=lambda: None, ip="127.0.0.1"
    )
    workers = WorkerPresence(context, lambda: None)
    name = f"{PRESENCE}dead"
    core = SimpleNamespace(
        name=f"{PRESENCE}me",
        outputs=list,
        inputs=list,
        add_output=lambda _name: (tried.append(now - 100.0), (False, ""))[1],
    )
    workers._core = core  # type: ignore[assignment]
    contacts = {name: PortContact(name, "127.0.0.1", 10002)}
    for _ in range(60):
        workers.connect(contacts, now)
        now += 1.0
    assert tried == [0.0, 2.0, 6.0, 14.0, 30.0, 46.0]
    workers._on_event(
        ConnectionEvent(ConnectionRoute(name, core.name, "tcp"), up=True, incoming=True)
    )  # the other worker is alive after all
    workers.connect(contacts, now)
    assert tried[-1] == 60.0

"""Ports that find each other without a name server."""

from __future__ import annotations

import selectors
from collections.abc import Callable, Iterator

import pytest

from yarp_compat import threaded_loop
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.port import PortCore

MakePort = Callable[..., PortCore]


@pytest.fixture
def naming() -> LocalNaming:
    """A name registry for one test."""
    return LocalNaming()


@pytest.fixture
def fill_select(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Let ports share a loop on ``select``, as on Windows; return a function after which the loop accepts no socket."""
    monkeypatch.setattr(selectors, "DefaultSelector", selectors.SelectSelector)
    return lambda: monkeypatch.setattr(threaded_loop, "_SELECT_LIMIT", 0)


@pytest.fixture
def make_port(naming: LocalNaming) -> Iterator[MakePort]:
    """Open ports, which are closed after the test."""
    ports: list[PortCore] = []

    def make(name: str, on_message: object = None, **options: object) -> PortCore:
        port = PortCore(name, on_message=on_message, naming=naming, **options)  # type: ignore[arg-type]
        port.open()
        ports.append(port)
        return port

    yield make
    for port in ports:
        port.close()

"""Making persistent connections: several at a time, again where it did not work, and an end."""

from __future__ import annotations

import threading

import pytest

from tests.support.wait import until
from yarp_compat.naming import connections as module
from yarp_compat.naming.connections import Connector
from yarp_compat.naming.subscriptions import WantedConnection
from yarp_compat.ports.naming import LocalNaming, PortError


class Ports:
    """In place of other programs' ports: some are slow, some fail at first."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.tries: list[str] = []
        self.failures: dict[str, int] = {}
        self.go_on = threading.Event()

    def is_connected(self, _naming: object, source: str, _target: str, *, timeout: float) -> bool:
        """Those that are called so are."""
        assert timeout
        return source == "/connected"

    def connect(self, _naming: object, source: str, _target: str, *, timeout: float) -> None:
        """Slow ones wait to be told; others may fail."""
        assert timeout
        self.tries.append(source)
        if source == "/slow":
            assert self.go_on.wait(10.0)
        if self.failures.get(source, 0) > 0:
            self.failures[source] -= 1
            raise PortError(source)
        self.made.append(source)


@pytest.fixture(name="ports")
def fixture_ports(monkeypatch: pytest.MonkeyPatch) -> Ports:
    """The ports, and quick tries."""
    ports = Ports()
    monkeypatch.setattr(module, "is_connected", ports.is_connected)
    monkeypatch.setattr(module, "connect", ports.connect)
    monkeypatch.setattr(module, "PAUSES", (0.0, 0.01, 0.01))
    return ports


def test_one_slow_port_holds_up_no_other(ports: Ports) -> None:
    """Also when all are wanted at once, by a connector that was idle."""
    connector = Connector(LocalNaming())
    connector.want(WantedConnection("/first", "/r"))
    until(lambda: ports.made == ["/first"], "it works")
    for source in ("/slow", "/a", "/b", "/slow", "/connected"):
        connector.want(WantedConnection(source, "/r"))
    until(lambda: set(ports.made) >= {"/a", "/b"}, "the others are made")
    ports.go_on.set()
    until(lambda: "/slow" in ports.made, "so is the slow one")
    connector.close()
    assert ports.tries.count("/slow") == 1
    assert "/connected" not in ports.tries


def test_again_where_it_did_not_work(ports: Ports, caplog: pytest.LogCaptureFixture) -> None:
    """A few times; then it is said, and wanted anew it is tried anew."""
    ports.failures = {"/late": 2, "/never": 99}
    connector = Connector(LocalNaming())
    connector.want(WantedConnection("/late", "/r"))
    connector.want(WantedConnection("/never", "/r"))
    until(lambda: ports.made == ["/late"], "the third try worked")
    until(lambda: "persistent connection from /never to /r not made" in caplog.text, "it is said")
    assert ports.tries.count("/never") == 3
    ports.failures.clear()
    until(lambda: _wanted(connector, ports), "it is made")
    connector.close()
    connector.want(WantedConnection("/after", "/r"))
    assert "/after" not in ports.tries


def _wanted(connector: Connector, ports: Ports) -> bool:
    connector.want(WantedConnection("/never", "/r"))
    return "/never" in ports.made


def test_connected_but_to_a_former_port(ports: Ports) -> None:
    """A writer that believes itself connected is told to connect to the new one."""
    connector = Connector(LocalNaming())
    connector.want(WantedConnection("/connected", "/r", anew=True))
    until(lambda: ports.made == ["/connected"], "connected anew")
    connector.close()

"""The connector makes persistent connections in parallel, retries failed ones, and closes."""

from __future__ import annotations

import threading

import pytest

from tests.support.wait import until
from yarp_compat.naming import connections as module
from yarp_compat.naming.connections import Connector
from yarp_compat.naming.subscriptions import WantedConnection
from yarp_compat.ports.naming import LocalNaming, PortError


class Ports:
    """A stand-in for the ports of other programs: some are slow, some fail at first."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.tries: list[str] = []
        self.failures: dict[str, int] = {}
        self.go_on = threading.Event()

    def is_connected(self, _naming: object, source: str, _target: str, *, timeout: float) -> bool:
        """Return whether the source is the port that the test treats as connected."""
        assert timeout
        return source == "/connected"

    def connect(self, _naming: object, source: str, _target: str, *, timeout: float) -> None:
        """Connect; slow ports wait for ``go_on``, others may fail."""
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
    """Replace the connections module's functions, and shorten the pauses."""
    ports = Ports()
    monkeypatch.setattr(module, "is_connected", ports.is_connected)
    monkeypatch.setattr(module, "connect", ports.connect)
    monkeypatch.setattr(module, "PAUSES", (0.0, 0.01, 0.01))
    return ports


def test_a_slow_port_does_not_delay_others(ports: Ports) -> None:
    """This also holds if all connections are requested at once from an idle connector."""
    connector = Connector(LocalNaming())
    connector.request(WantedConnection("/first", "/r"))
    until(lambda: ports.made == ["/first"], "the first connection is made")
    for source in ("/slow", "/a", "/b", "/slow", "/connected"):
        connector.request(WantedConnection(source, "/r"))
    until(lambda: set(ports.made) >= {"/a", "/b"}, "the other connections are made")
    ports.go_on.set()
    until(lambda: "/slow" in ports.made, "the slow connection is made")
    connector.close()
    assert ports.tries.count("/slow") == 1
    assert "/connected" not in ports.tries


def test_a_port_that_hangs_does_not_delay_closing(ports: Ports, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CLOSE_SECONDS", 0.05)
    connector = Connector(LocalNaming())
    connector.request(WantedConnection("/slow", "/r"))
    until(lambda: ports.tries == ["/slow"], "the attempt has begun")
    connector.close()
    assert any(thread.name.startswith("yarp connector") for thread in threading.enumerate()), "the attempt goes on"
    ports.go_on.set()
    until(lambda: ports.made == ["/slow"], "the attempt ends")


def test_failed_connections_are_retried(ports: Ports, caplog: pytest.LogCaptureFixture) -> None:
    """After the last attempt, the failure is logged; a new request starts new attempts."""
    ports.failures = {"/late": 2, "/never": 99}
    connector = Connector(LocalNaming())
    connector.request(WantedConnection("/late", "/r"))
    connector.request(WantedConnection("/never", "/r"))
    until(lambda: ports.made == ["/late"], "the third attempt succeeds")
    until(lambda: "persistent connection from /never to /r failed" in caplog.text, "the failure is logged")
    assert ports.tries.count("/never") == 3
    ports.failures.clear()
    until(lambda: _request_again(connector, ports), "the connection is made")
    connector.close()
    connector.request(WantedConnection("/after", "/r"))
    assert "/after" not in ports.tries


def _request_again(connector: Connector, ports: Ports) -> bool:
    connector.request(WantedConnection("/never", "/r"))
    return "/never" in ports.made


def test_the_connector_survives_unexpected_errors(ports: Ports, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each error would otherwise end one of the connector's few threads."""

    def connect(_naming: object, source: str, target: str, *, timeout: float) -> None:
        if source.startswith("/odd"):
            raise LookupError(source)
        ports.connect(_naming, source, target, timeout=timeout)

    monkeypatch.setattr(module, "connect", connect)
    connector = Connector(LocalNaming())
    for number in range(module.WORKERS):
        connector.request(WantedConnection(f"/odd{number}", "/r"))
    connector.request(WantedConnection("/a", "/r"))
    until(lambda: ports.made == ["/a"], "the connection is made")
    connector.close()


def test_a_forced_connection_replaces_the_connection_to_an_earlier_port_with_the_name(ports: Ports) -> None:
    """A writer that reports itself as connected must connect to the new port."""
    connector = Connector(LocalNaming())
    connector.request(WantedConnection("/connected", "/r", force=True))
    until(lambda: ports.made == ["/connected"], "the connection is made again")
    connector.close()


def test_a_port_that_opens_again_during_an_attempt_is_connected_again(ports: Ports) -> None:
    """The attempt may have connected its earlier program, which was about to end."""
    connector, wanted = Connector(LocalNaming()), WantedConnection("/slow", "/r", force=True)
    connector.request(wanted)
    until(lambda: ports.tries == ["/slow"], "the attempt has begun")
    connector.request(wanted)
    ports.go_on.set()
    until(lambda: ports.made == ["/slow", "/slow"], "the connection is made again")
    connector.close()

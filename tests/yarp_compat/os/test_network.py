"""`Network` with a name server of Midspan."""

from __future__ import annotations

import logging
import threading

import pytest

import yarp_compat as yarp
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.server import NameServer
from yarp_compat.os.runtime import RUNTIME

pytestmark = pytest.mark.usefixtures("name_server")


@pytest.fixture
def ports() -> tuple[yarp.Port, yarp.Port]:
    reader, writer = yarp.Port(), yarp.Port()
    reader.setReader(Ignore())
    assert reader.open("/r")
    assert writer.open("/w")
    return reader, writer


class Ignore(yarp.PortReader):
    def read(self, connection: yarp.ConnectionReader) -> bool:
        return yarp.Bottle().read(connection) if connection.isValid() else False


def test_connect_and_disconnect(ports: tuple[yarp.Port, yarp.Port]) -> None:
    reader, writer = ports
    assert yarp.Network.checkNetwork()
    assert yarp.Network.checkNetwork(40.0)
    assert yarp.Network.exists("/r")
    assert not yarp.Network.isConnected("/w", "/r")
    assert yarp.Network.connect("/w", "/r")
    assert yarp.Network.isConnected("/w", "/r")
    assert yarp.Network.isConnected("/w", "/r", "tcp")
    assert not yarp.Network.isConnected("/w", "/r", "udp")
    assert yarp.Network.connect("/w", "/r", "fast_tcp")  # another carrier replaces the connection
    assert yarp.Network.isConnected("/w", "/r", "fast_tcp")
    until(lambda: reader.getInputCount() == 1, "only one connection is left")
    assert yarp.Network.disconnect("/w", "/r")
    assert not yarp.Network.isConnected("/w", "/r")
    assert writer.getOutputCount() == 0


def test_style_selects_the_carrier(ports: tuple[yarp.Port, yarp.Port]) -> None:
    style = yarp.ContactStyle()
    style.carrier, style.quiet, style.timeout = "fast_tcp", True, 40.0
    assert yarp.Network.connect("/w", "/r", style)
    assert yarp.Network.isConnected("/w", "/r", "fast_tcp")
    assert yarp.Network.disconnect("/w", "/r", style)


def test_persistent_connection_is_made_when_the_ports_open(name_server: NameServer) -> None:
    style = yarp.ContactStyle()
    style.persistent = True
    assert yarp.Network.connect("/later/w", "/later/r", style)
    reader, writer = yarp.Port(), yarp.Port()
    assert reader.open("/later/r")
    assert writer.open("/later/w")
    assert yarp.Network.waitConnection("/later/w", "/later/r", True)
    assert yarp.Network.disconnect("/later/w", "/later/r", style)


def test_failures_return_false_and_log_the_reason(caplog: pytest.LogCaptureFixture, ports: object) -> None:
    assert not yarp.Network.connect("/w", "/nowhere")
    assert "/nowhere" in caplog.text
    assert not yarp.Network.disconnect("/w", "/r")
    assert not yarp.Network.connect("/w", "/r", "carrier_pigeon")
    assert not yarp.Network.exists("/nowhere")
    assert not yarp.Network.queryName("/nowhere").isValid()
    assert not yarp.Network.isConnected("/nowhere", "/r")


def test_names_are_registered_and_queried() -> None:
    contact = yarp.Network.registerName("/robot/thing")
    assert contact.isValid()
    assert contact.getRegName() == "/robot/thing"
    queried = yarp.Network.queryName("/robot/thing")
    assert (queried.getPort(), queried.getCarrier(), queried.toURI()) == (contact.getPort(), "tcp", contact.toURI())
    assert yarp.Network.setProperty("/robot/thing", "color", yarp.Value("red"))
    assert yarp.Network.getProperty("/robot/thing", "color").asString() == "red"
    assert yarp.Network.getProperty("/robot/thing", "size") is None
    yarp.Network.unregisterName("/robot/thing")
    assert not yarp.Network.queryName("/robot/thing").isValid()
    other = yarp.Network.registerContact(yarp.Contact("/robot/other", "tcp", "127.0.0.1", 12345))
    assert other.getPort() == 12345
    assert yarp.Network.getNameServerName() == "/root"
    assert yarp.Network.isValidPortName("/a/b")
    assert not yarp.Network.isValidPortName("a b")


def test_wait_port_returns_when_the_port_opens() -> None:
    port = yarp.Port()
    thread = threading.Timer(0.1, lambda: port.open("/late"))
    thread.start()
    assert yarp.Network.waitPort("/late", True)
    assert yarp.Network.sync("/late")
    thread.join()
    port.close()


def test_a_bottle_is_written_without_a_port(ports: object) -> None:
    class Answer(yarp.PortReader):
        def read(self, connection: yarp.ConnectionReader) -> bool:
            command = yarp.Bottle()
            return command.read(connection) and yarp.Bottle(["got", *command]).write(connection.getWriter())

    server, answer = yarp.RpcServer(), yarp.Bottle()
    server.setReader(Answer())
    assert server.open("/server")
    for place in ("/server", yarp.Network.queryName("/server")):
        assert yarp.Network.write(place, yarp.Bottle("a 1"), answer)
        assert answer.toString() == "got a 1"
    assert yarp.Network.write(yarp.Contact("/server"), yarp.Bottle("[ver]"), answer, True, True, 40.0)
    assert answer.get(0).asVocab32() == yarp.createVocab32("v", "e", "r")
    assert not yarp.Network.write("/nowhere", yarp.Bottle("a"), answer)
    assert yarp.Network.writeToNameServer(yarp.Bottle("query /server"), answer)
    assert "/server" in answer.toString()


def test_network_object_initializes_and_finalizes() -> None:
    with yarp.Network():
        assert RUNTIME.is_up
    network = yarp.Network()
    del network
    assert yarp.Network.initialized()  # because the fixture initialized it


def test_another_name_server_can_be_selected() -> None:
    with NameServer(port=free_port()) as other:
        address = yarp.Contact("/root", "tcp", other.address.host, other.address.port)
        assert yarp.Network.setNameServerContact(address)
        assert yarp.Network.getNameServerContact().getPort() == other.address.port
        port = yarp.Port()
        assert port.open("/there")
        assert [c.name for c in NameClient(other.address).list("/there")] == ["/there"]
        port.close()
    assert not yarp.Network.setNameServerContact(yarp.Contact())


def test_a_missing_name_server_fails_each_call(caplog: pytest.LogCaptureFixture) -> None:
    assert yarp.Network.setNameServerContact(yarp.Contact("/root", "tcp", "127.0.0.1", free_port()))
    assert not yarp.Network.checkNetwork(0.5)
    assert not yarp.Port().open("/x")
    assert not yarp.Network.connect("/a", "/b")
    assert not yarp.Network.registerName("/x").isValid()
    assert "name server" in caplog.text


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let administrative commands wait for a busy machine, although they have time limits of two seconds."""
    write = yarp.Network.write
    monkeypatch.setattr(yarp.Network, "write", staticmethod(lambda *given: write(*given[:5], 40.0)))


@pytest.mark.usefixtures("patient")
def test_the_type_of_service_of_a_connection_is_set_and_read(ports: tuple[yarp.Port, yarp.Port]) -> None:
    style, at_source, at_target = yarp.QosStyle(), yarp.QosStyle(), yarp.QosStyle()
    style.setPacketPriorityByLevel(yarp.QosStyle.PacketPriorityHigh)
    assert yarp.Network.connect("/w", "/r")
    until(lambda: ports[0].getInputCount() == 1, "the port is connected")
    assert yarp.Network.setConnectionQos("/w", "/r", style)
    assert yarp.Network.getConnectionQos("/w", "/r", at_source, at_target)
    assert at_source.getPacketPriorityAsTOS() == at_target.getPacketPriorityAsTOS() == 144
    assert at_source.getPacketPriorityAsLevel() == yarp.QosStyle.PacketPriorityHigh
    assert not yarp.Network.setConnectionQos("/w", "/nowhere", style)
    assert not yarp.Network.getConnectionQos("/nowhere", "/r", at_source, at_target)
    assert yarp.Network.disconnectInput("/w", "/r")
    until(lambda: ports[0].getInputCount() == 0, "the connection has ended")
    assert not yarp.Network.disconnectInput("/w", "/r")


@pytest.mark.parametrize(
    ("text", "tos", "dscp"),
    [("LEVEL:CRIT", 176, 44), ("DSCP:AF11", 40, 10), ("TOS:5", 5, 0x7FFF), ("DSCP:XX", -1, -1), ("HIGH", -1, -1)],
)
def test_styles_of_service_are_parsed(text: str, tos: int, dscp: int) -> None:
    style = yarp.QosStyle()
    assert style.setPacketPriority(text) == (tos >= 0)
    assert (style.getPacketPriorityAsTOS(), style.getPacketPriorityAsDSCP()) == (tos, dscp)


@pytest.mark.parametrize(("verbosity", "level"), [(-1, "WARNING"), (0, "INFO"), (1, "DEBUG")])
def test_verbosity_sets_the_log_level(verbosity: int, level: str) -> None:
    yarp.Network.setVerbosity(verbosity)
    assert logging.getLevelName(logging.getLogger("yarp").level) == level
    yarp.Network.setVerbosity(0)

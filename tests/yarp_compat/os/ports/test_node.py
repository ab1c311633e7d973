"""Nodes, publishers and subscribers: names, types, connections, and the warning without a daemon."""

from __future__ import annotations

import gc
from typing import Any

import pytest

import yarp_compat as yarp
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.server import NameServer
from yarp_compat.ports import text_client
from yarp_compat.ports.port import PortCore
from yarp_compat.pythonic import Server
from yarp_compat.wire.values import Vocab

String = yarp.rosmsg.std_msgs.String


def names(server: NameServer) -> list[str]:
    return [contact.name for contact in NameClient(server.address).list()]


def test_topics_belong_to_the_newest_node(name_server: NameServer) -> None:
    with yarp.Node("/talker") as node:
        publisher, subscriber = yarp.Publisher(String), yarp.Subscriber(String)
        assert publisher.topic("/chatter")
        assert subscriber.topic("/chatter")
        assert (publisher.getName(), subscriber.getName()) == ("/chatter+@/talker", "/chatter-@/talker")
        with yarp.Node("/second"):
            other = yarp.Publisher(String, "/else")
            assert other.getName() == "/else+@/second"
        assert not other.isOpen()  # closed with its node
        assert {"/talker", "/chatter+@/talker", "/chatter-@/talker"} <= set(names(name_server))
        assert node.getName() == "/talker"
    assert names(name_server) == ["/root"]


def test_yarp_programs_exchange_messages(name_server: NameServer) -> None:
    publisher = yarp.Publisher("std_msgs/String", "/chatter@/talker")
    subscriber = yarp.Subscriber("std_msgs/String", "/chatter@/listener")
    until(subscriber.getInputCount, "the subscriber is connected")
    assert publisher.write(String(data="hello"))
    assert subscriber.read().data == "hello"
    publisher.prepare().data = "prepared"
    publisher.write()
    got = String()
    assert subscriber.read(got)
    assert got.data == "prepared"
    later = yarp.Publisher(String, "/chatter@/third")
    until(lambda: subscriber.getInputCount() == 2, "the publisher of /third is connected")
    assert later.getOutputCount() == 1


def test_callback_receives_messages(name_server: NameServer) -> None:
    got = []
    subscriber = yarp.Subscriber(String)
    subscriber.setStrict()
    subscriber.useCallback(lambda message: got.append(message.data))
    assert subscriber.topic("/chatter@/listener")
    publisher = yarp.Publisher(String, "/chatter@/talker")
    for text in ("a", "b"):
        assert publisher.write(String(data=text))
    until(lambda: got == ["a", "b"], "the messages have arrived")


def test_type_is_announced(name_server: NameServer) -> None:
    publisher = yarp.Publisher(String, "/chatter@/talker")
    naming = NameClient(name_server.address)
    assert naming.get_property("/chatter+@/talker", "type") == ["std_msgs/String"]
    answer = yarp.Bottle()
    request = yarp.Bottle("[prop] [get] /chatter+@/talker")
    assert yarp.Network.write(publisher.getName(), request, answer, True)
    assert '(type "std_msgs/String")' in answer.toString()


def test_ordinary_ports_are_topics_too(name_server: NameServer) -> None:
    writer, reader = yarp.Port(), yarp.BufferedPortBottle()
    writer.setWriteOnly()
    assert writer.open("/count@/program~std_msgs/Int32")
    assert writer.getName() == "/count+@/program"
    assert NameClient(name_server.address).get_property("/count+@/program", "type") == ["std_msgs/Int32"]
    assert reader.open("/count-@/other")
    until(reader.getInputCount, "the reader is connected")
    assert writer.write(yarp.Bottle("5"))
    assert reader.read().get(0).asInt32() == 5


def test_a_service_of_a_node_is_called(name_server: NameServer) -> None:
    class Add(yarp.PortReader):
        def read(self, connection: yarp.ConnectionReader) -> bool:
            numbers = yarp.Bottle()
            return numbers.read(connection) and yarp.Bottle([sum(numbers)]).write(connection.getWriter())

    server, client, reply = yarp.RpcServer(), yarp.RpcClient(), yarp.Bottle()
    server.setReader(Add())
    assert server.open("/add@/server")
    assert client.open("/add@/client")
    assert (server.getName(), client.getName()) == ("/add-1@/server", "/add+1@/client")
    assert client.write(yarp.Bottle("22 20"), reply)
    assert reply.get(0).asInt32() == 42


def test_missing_daemon_is_logged(name_server: NameServer, caplog: pytest.LogCaptureFixture) -> None:
    publisher = yarp.Publisher(String, "/chatter@/talker")
    assert "no Midspan daemon" in caplog.text
    assert "/chatter" in caplog.text
    del publisher
    gc.collect()


def test_daemon_is_found_and_answers_definitions(name_server: NameServer, caplog: pytest.LogCaptureFixture) -> None:
    naming = NameClient(name_server.address)

    def answer(values: list[object]) -> list[object]:
        return (
            ["ok", "int32 x\nOther o\n" + "=" * 80 + "\nMSG: odd/Other\nstring s"]
            if values[1] == "odd/Type"
            else ["fail", ""]
        )

    with Server("/midspan/daemon/r1", answer, naming=naming):
        naming.set_property("/midspan/daemon/r1", "midspan_owner", "r1")
        message = yarp.rosmsg.odd.Type(x=3)
        assert message.o.s == ""
        publisher = yarp.Publisher(type(message), "/odd@/talker")
        assert publisher.getType() == "odd/Type"
        with pytest.raises(yarp.rosmsg.DefinitionError, match="odd/Unknown"):
            yarp.rosmsg.get("odd/Unknown")
    assert "no Midspan daemon" not in caplog.text


def test_late_joiner_receives_the_latched_message(name_server: NameServer) -> None:
    publisher = yarp.Publisher(String, latched=True)
    assert publisher.topic("/map@/server")
    naming = NameClient(name_server.address)
    assert naming.get_property("/map+@/server", "latched") == [True]
    contact = naming.query("/map+@/server")
    assert contact is not None
    assert text_client.admin(contact, [Vocab("prop"), Vocab("get"), "latched"]) == [1]
    assert publisher.write(String(data="old"))
    publisher.prepare().data = "new"
    publisher.write()
    for node in ("/a", "/b"):
        assert yarp.Subscriber(String, f"/map@{node}").read().data == "new"


def test_late_joiner_ends_with_the_newest_latched_message(
    name_server: NameServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The publisher writes a newer message while it is about to repeat the last one."""
    publisher, write, got = yarp.Publisher(String, "/map@/server", latched=True), PortCore.write, list[str]()
    assert publisher.write(String(data="old"))

    def write_late(core: PortCore, *content: Any, **options: Any) -> int:
        if "chosen" in options:
            monkeypatch.setattr(PortCore, "write", write)
            assert publisher.write(String(data="new"))
        return write(core, *content, **options)

    monkeypatch.setattr(PortCore, "write", write_late)
    subscriber = yarp.Subscriber(String)
    subscriber.setStrict()
    subscriber.useCallback(lambda message: got.append(message.data))
    assert subscriber.topic("/map@/late")
    until(lambda: len(got) == 3, "the messages have arrived")
    assert got == ["new", "old", "new"]


def test_missing_node_and_direction_are_errors(name_server: NameServer, caplog: pytest.LogCaptureFixture) -> None:
    assert not yarp.Publisher(String).topic("/chatter")
    assert "yarp.Node" in caplog.text
    assert not yarp.Port().open("/chatter@/node")

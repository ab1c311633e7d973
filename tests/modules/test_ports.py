"""A module's YARP ports, without its host."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path

import pytest

from bridge.config.model import Config
from bridge.modules.loop import EventLoop
from bridge.modules.ports import HostedPort, Ports
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Client, Reader, Writer, payload_of
from yarp_compat.wire.values import Vocab


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the name server, which runs in this process, stand still."""
    monkeypatch.setattr("bridge.modules.ports._ASK_SECONDS", 40.0)


@pytest.fixture
def config(tmp_path: Path) -> Config:
    yarp = {"address": f"127.0.0.1:{free_port()}", "namespace": "/root", "ip": "127.0.0.1"}
    return Config.model_validate({"name": "here", "state": tmp_path, "yarp": yarp})


class Held(threading.Event):
    """An event that another thread sets again while the ports' own thread is about to clear it."""

    def __init__(self) -> None:
        super().__init__()
        self.armed, self.clearing, self.set_again = False, threading.Event(), threading.Event()

    def set(self) -> None:
        super().set()
        if self.clearing.is_set():
            self.set_again.set()

    def clear(self) -> None:
        if self.armed:
            self.clearing.set()
            assert self.set_again.wait(40)
        super().clear()


def threads() -> set[threading.Thread]:
    """Return the threads of all modules' ports in this process."""
    return {thread for thread in threading.enumerate() if thread.name == "midspan-ports"}


def test_closing_ports_ends_their_waking_thread(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    ports, wake, others = Ports(config, "test"), Held(), threads()
    monkeypatch.setattr(ports, "_wake", wake)
    monkeypatch.setattr(ports, "_open", lambda port: setattr(port, "trouble", ""))
    ports.output("/said:o")
    until(lambda: not ports.trouble(), "the port is open")
    (thread,) = threads() - others
    wake.armed = True
    wake.set()
    assert wake.clearing.wait(40)
    ports.close()
    assert not thread.is_alive()


def test_call_to_a_module_without_a_thread_gets_an_error(config: Config) -> None:
    loop, ports = EventLoop("the thread"), Ports(config, "test")
    loop.start()
    with NameServer(port=Address(*config.yarp.place).port, gc_seconds=0):
        port = ports.respond("/rpc", lambda values: loop.call(lambda: ["heard", *values], 40.0))
        until(lambda: not port.trouble, "the port is open")
        with Client("/rpc", naming=ports.naming) as client:
            assert client.ask(["one"], timeout=40) == ["heard", "one"]
            loop.close()
            assert client.ask(["two"], timeout=40) == [Vocab("fail"), "the thread has ended"]
        ports.close()


def test_connection_during_port_registration_loses_nothing(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    ports, registered = Ports(config, "test"), threading.Event()

    def open_core(port: HostedPort) -> None:
        """Only open and register the port; the steps that follow never run."""
        if not registered.is_set():
            with contextlib.suppress(OSError):  # the name server may stand still; the thread tries again
                port.core.open()
                registered.set()

    monkeypatch.setattr(ports, "_open", open_core)
    with NameServer(port=Address(*config.yarp.place).port, gc_seconds=0):
        port = ports.output("/said:o")
        assert registered.wait(40)
        with Reader("/heard:i", naming=ports.naming) as reader:
            connections.connect(ports.naming, "/said:o", "/heard:i")
            assert port.trouble
            assert port.write(["first"]) == 1
            received = reader.read()
            assert received is not None
            assert received.values == ["first"]
        ports.close()


def test_message_that_arrives_while_a_port_is_being_added_is_received(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread that adds the port is suspended as soon as the port may open."""
    ports, received, start = Ports(config, "test"), list[list[object]](), threading.Thread.start

    def start_and_wait(thread: threading.Thread) -> None:
        start(thread)
        if thread.name == "midspan-ports":
            with Writer("/said:o", naming=ports.naming) as writer:
                until(lambda: writer.core.add_output("/heard:i")[0], "the port is open")
                writer.core.write(payload_of(["first"]), wait=True, timeout=40)

    monkeypatch.setattr(threading.Thread, "start", start_and_wait)
    with NameServer(port=Address(*config.yarp.place).port, gc_seconds=0):
        port = ports.input("/heard:i", lambda message: received.append(message.values))
        until(lambda: received, "the message is received")
        ports.close()
    assert received == [["first"]]
    assert port.counters.as_dict()["messages"] == 1


def test_each_reader_gets_the_form_of_its_release(config: Config, caplog: pytest.LogCaptureFixture) -> None:
    """The release comes from a rule, from the network's setting, or from the default.

    The log and the status name the readers for which the default is used.
    """
    rules = {"peers": [{"port": "/older/*", "release": "3.9"}]}
    changed = config.model_copy(update={"yarp": type(config.yarp)(**{**config.yarp.model_dump(), **rules})})
    ports = Ports(changed, "test")
    with NameServer(port=Address(*config.yarp.place).port, gc_seconds=0):
        port = ports.output("/battery/data:o", by_release=True)
        until(lambda: not port.trouble, "the port is open")
        with (
            Reader("/older/data:i", naming=ports.naming) as older,
            Reader("/client/data:i", naming=ports.naming) as unknown,
            Reader("/plain", naming=ports.naming) as plain,
        ):
            for reader in (older, unknown, plain):
                connections.connect(ports.naming, "/battery/data:o", reader.name)
            for settings, values in ((rules, ["3.6", "3.12", "3.12"]), ({"release": "3.9"}, ["3.6", "3.6", "3.6"])):
                section = type(config.yarp)(**{**config.yarp.model_dump(), **settings})
                ports.generations.adopt(section.generations())
                assert port.write_by_release(lambda generation: [generation.value]) == 3
                received = [reader.read() for reader in (older, unknown, plain)]
                assert [message and message.values[0] for message in received] == values
            ports.generations.adopt(changed.yarp.generations())
            peers = {peer["port"]: peer for peer in port.status()["peers"]}
        ports.close()
    assert peers.keys() == {"/older/data:i", "/client/data:i"}, "a plain reader interprets the values itself"
    assert "port: /client/data:i, release: '3.9'" in peers["/client/data:i"]["generation_cure"]
    assert "generation_cure" not in peers["/older/data:i"]
    lines = [text for text in caplog.messages if "release" in text and "/battery/data:o" in text]
    assert len(lines) == 1
    assert "/battery/data:o: the YARP release of its reader /client/data:i is unknown" in lines[0]

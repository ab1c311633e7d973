"""Clients of a module's RPC ports after its process is killed: their calls fail at once, and they reconnect later."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.config.model import Config
from bridge.modules.ports import Ports
from bridge.reconnecting_clients import ReconnectingClients, clients_file
from bridge.state_file import worker_folder
from tests.peers.yarp.native_client import NativeClient
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.ports import text_client
from yarp_compat.ports.port import PortCore
from yarp_compat.pythonic import Client
from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

HELLO = binary.encode(["hello"], Profile.YARP3)
SAID = binary.encode(["said", "hello"], Profile.YARP3)


@pytest.fixture
def config(tmp_path: Path) -> Iterator[Config]:
    port = free_port()
    yarp = {"address": f"127.0.0.1:{port}", "namespace": "/root", "ip": "127.0.0.1"}
    with NameServer(port=port, gc_seconds=0):
        yield Config.model_validate({"name": "here", "state": tmp_path, "yarp": yarp})


@pytest.fixture
def names(config: Config) -> NameClient:
    assert config.yarp.place is not None
    return NameClient(Address(*config.yarp.place), namespace="/root")


class Modules:
    """A process with a module's port, which can be killed."""

    def __init__(self, config: Config) -> None:
        self._args = [
            sys.executable,
            "-m",
            "tests.modules.test_reconnecting_clients",
            config.model_dump_json(include={"name", "state", "yarp"}),
        ]
        self._process: Process | None = None

    def start(self) -> None:
        self._process = Process(self._args, os.environ)

    def kill(self) -> None:
        assert self._process is not None
        self._process.signal(signal.SIGKILL)
        self._process.stop()


@pytest.fixture
def modules(config: Config) -> Iterator[Modules]:
    running = Modules(config)
    running.start()
    yield running
    running.kill()


def _stored(config: Config) -> list[str]:
    file = clients_file(worker_folder(config), "echo")
    return sorted(json.loads(file.read_text()).get("/echo/rpc", {})) if file.exists() else []


def test_a_native_client_is_served_again_after_a_restart_of_the_module(
    config: Config, names: NameClient, modules: Modules
) -> None:
    with contextlib.closing(NativeClient("/native/rpc", names)) as client:
        until(lambda: client.connect("/echo/rpc"), "the port is registered")
        until(lambda: _stored(config), "the port's client is stored")
        for _ in range(2):
            assert client.call(HELLO) == SAID
            modules.kill()
            assert client.call(HELLO) is None  # the call fails at once
            modules.start()
            until(lambda: client.call(HELLO) == SAID, "calls are served again")
    until(lambda: not _stored(config), "a client that leaves is no longer stored")


def test_a_client_that_did_not_call_meanwhile_is_served_again(
    config: Config, names: NameClient, modules: Modules
) -> None:
    client = NativeClient("/native/rpc", names)  # it still lists the connection that has ended
    try:
        until(lambda: client.connect("/echo/rpc"), "the port is registered")
        until(lambda: _stored(config), "the port's client is stored")
        modules.kill()
        assert connections.is_connected(names, "/native/rpc", "/echo/rpc")
        modules.start()
        until(lambda: "/native/rpc" in _inputs(names), "the client was asked to reconnect")
        until(lambda: client.call(HELLO) == SAID, "calls are served again")
    finally:
        client.close()


def test_yarp_compats_own_client_is_served_again(config: Config, names: NameClient, modules: Modules) -> None:
    until(lambda: connections.exists(names, "/echo/rpc"), "the port is registered")
    with Client("/echo/rpc", naming=names) as client:
        assert client.ask(["hello"], timeout=40) == ["said", "hello"]
        until(lambda: _stored(config), "the port's client is stored")
        modules.kill()
        with pytest.raises(OSError, match="closed"):
            client.ask(["hello"], timeout=40)
        modules.start()

        def served() -> bool:
            with contextlib.suppress(OSError):
                return client.ask(["hello"], timeout=40) == ["said", "hello"]
            return False

        until(served, "calls are served again")


def test_another_program_with_a_dead_clients_name_is_not_connected(
    config: Config, names: NameClient, modules: Modules
) -> None:
    client = NativeClient("/native/rpc", names)
    until(lambda: client.connect("/echo/rpc"), "the port is registered")
    until(lambda: _stored(config), "the port's client is stored")
    modules.kill()
    client.close()
    other = PortCore("/native/rpc", naming=names, rpc=True)
    other.open()
    try:
        modules.start()
        until(lambda: connections.exists(names, "/echo/rpc"), "the port is registered again")
        until(lambda: not _stored(config), "the port's former client is no longer stored")
        assert not other.connections.outputs
    finally:
        other.close()


def test_reopened_ports_recognize_their_clients(config: Config, names: NameClient) -> None:
    with contextlib.closing(NativeClient("/native/rpc", names)) as client:
        for _ in range(2):
            ports = _open(config)
            until(lambda: client.call(HELLO) == SAID or not _stored(config), "the client is asked to reconnect")
            if not _stored(config):
                until(lambda: client.connect("/echo/rpc"), "the port is registered")
            until(lambda: _stored(config) == ["/native/rpc"], "the port's client is stored")
            ports.close()
            assert client.call(HELLO) is None
            assert _stored(config) == ["/native/rpc"]


def test_invalid_file_is_ignored(config: Config, names: NameClient) -> None:
    file = clients_file(worker_folder(config), "echo")
    file.parent.mkdir(parents=True)
    file.write_text('{"/echo/rpc": {"/native/rpc": ["127.0.0.1"')
    clients = ReconnectingClients(names, file)
    core = PortCore("/echo/rpc", naming=names, rpc=True)
    clients.watch(core)
    assert not clients.update()


def _inputs(names: NameClient) -> list[str]:
    """Return the names of the clients that are connected to the port."""
    contact = names.query("/echo/rpc")
    assert contact is not None
    try:
        return [str(name) for name in text_client.admin(contact, [Vocab("list"), Vocab("in")])]
    except OSError:
        return []


def _open(config: Config) -> Ports:
    ports = Ports(config, "echo")
    ports.respond("/echo/rpc", lambda values: ["said", *values])
    return ports


if __name__ == "__main__":
    _open(Config.model_validate_json(sys.argv[1]))
    signal.pause()

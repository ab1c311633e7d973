"""A hub, a YARP network, and programs on both."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from tests.contract.yarpside import YarpBridge
from tests.peers.commands import Record
from tests.peers.hub.rig import HubRig
from tests.peers.yarp.name_server import RealNameServer
from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile

DEFINITIONS = Definitions(())
AnyNames = Names | RealNameServer


class YarpPort(Record):
    """A port of a YARP program without ROS, and the messages that it has received."""

    def __init__(
        self, names: AnyNames, name: str, profile: Profile = Profile.YARP3, naming: NameClient | None = None
    ) -> None:
        super().__init__()
        self.name, self.names, self.profile = name, names, profile
        self.core = PortCore(name, naming=naming or names.client, on_message=self.add, profile=profile)
        self.core.open()

    def messages(self, count: int = 1, seconds: float = 40.0) -> list[PortMessage]:
        """Wait for ``count`` messages, at most ``seconds``, and return all received messages."""
        return self.wait(count, seconds)

    def bottles(self, count: int = 1, seconds: float = 40.0) -> list[Any]:
        """Return the values of the received Bottles; waits like `messages`."""
        return [binary.decode(bytes(m.payload), self.profile) for m in self.messages(count, seconds)]

    def write(self, values: list[Any] | bytes, envelope: str = "") -> None:
        """Send a Bottle, or the bytes of another type."""
        payload = values if isinstance(values, bytes) else binary.encode(values, self.profile)
        self.core.write(payload, envelope, strict=True)

    def listen_to(self, port: str) -> None:
        """Connect another port to this one, as soon as the other port is open."""
        until(lambda: _connected(self.names, port, self.name), f"{port} is open")

    def write_to(self, port: str) -> None:
        """Connect this port to another one, as soon as the other port is open."""
        until(lambda: self.core.add_output(port)[0], f"{port} is open")

    def stop(self) -> None:
        self.core.close()


def _connected(names: AnyNames, source: str, target: str) -> bool:
    try:
        connections.connect(names.client, source, target)
    except NamingError:  # the port is registered, but not listening yet
        return False
    return True


class Place(HubRig):
    """The networks of one test, and the programs on them."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.names: AnyNames = Names()

    def config(self, name: str = "here", *, yarp: dict[str, Any] | None = None, **sections: Any) -> Config:
        """Return a configuration for this YARP network."""
        section = {"nameserver": "site", "address": self.names.endpoint, "poll": 0.1, **(yarp or {})}
        return super().config(name=name, yarp=section, **sections)

    def bridge(self, *topics: dict[str, Any], name: str = "here", **sections: Any) -> YarpBridge:
        """Start an adapter with these topic rules."""
        yarp = {"topics": list(topics), **sections.pop("yarp", {})}
        return self.keep(YarpBridge(self.config(name, yarp=yarp, **sections)))

    def port(self, name: str, profile: Profile = Profile.YARP3) -> YarpPort:
        """Open a port of a YARP program."""
        return self.keep(YarpPort(self.names, name, profile))

    def program(self, node: str) -> YarpProgram:
        """Start a YARP program with ports named ``/topic@/node``."""
        return self.keep(YarpProgram(self.names.client, node, DEFINITIONS))

    def close(self) -> None:
        super().close()
        self.names.stop()


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as place:
        yield place

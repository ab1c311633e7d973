"""The zenoh and YARP workers run on any OS: complete workers, with everything hidden that Windows lacks."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.contract.side import PeerLike
from tests.peers.hub.quick import QuickHub
from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.peers.zenoh.programs import Ros2ddsBridge, Router
from tests.support.hidden import as_on, is_windows_name
from tests.support.process import Process
from tests.support.rosbags_messages import Messages
from tests.support.wait import until

STRING = "std_msgs/String"


@pytest.fixture
def hubs() -> Iterator[QuickHub]:
    """A separate hub for the test."""
    quick_hub = QuickHub()
    yield quick_hub
    quick_hub.stop_router()


@contextmanager
def worker(side: str, hubs: QuickHub, folder: Path, **sections: Any) -> Iterator[HubSide]:
    """Run a side's worker in a separate process, which must stop cleanly; yield a program on its hub.

    The daemon's name is not a valid file name on Windows; the files in its state folder must be valid.
    """
    file = folder / "midspan.yaml"
    state = folder / "state"
    config = {"name": "CON", "state": str(state), "hub": {"listen": hubs.endpoint, "shared_memory": False}}
    file.write_text(yaml.safe_dump({**config, **sections}))
    far = HubSide(Hub.open(hubs.settings("far")), Registry())
    command = [sys.executable, "-m", "bridge.cli.main", "worker", side, "--config", file]
    with Process(command, as_on("windows")) as process:
        try:
            until(lambda: process.popen.poll() is not None or runs(far), "the worker runs", 30)
            yield far
            assert process.popen.poll() is None, "the worker ended by itself"
            process.signal(signal.SIGINT)  # Ctrl-C, which every OS has
            assert process.popen.wait(20) == 0
            file_names = [path.name for path in state.rglob("*")]
            assert "%43ON" in file_names
            assert [name for name in file_names if not is_windows_name(name)] == []
        except BaseException:
            print(process.output())
            raise
        finally:
            far.hub.close()


def runs(far: HubSide) -> bool:
    return any(isinstance(a.value, dict) and a.value.get("state") == "running" for a in far.hub.ask("status", {}))


def assert_crosses(far: HubSide, peer: PeerLike) -> None:
    """Exchange messages between a program on the side and one on the hub."""
    peer_publisher, far_subscription = peer.advertise("/from_side", STRING), far.subscribe("/from_side", STRING)
    far.publish_until(peer, peer_publisher, {"data": "in"}, lambda: far.wait(far_subscription, 1, 0.2))
    assert far.wait(far_subscription, 1)[0] == {"data": "in"}
    peer_subscription, far_publisher = peer.subscribe("/from_hub", STRING), far.advertise("/from_hub", STRING)
    far.hub_publish_until(far_publisher, {"data": "out"}, lambda: peer.wait(peer_subscription, 1, 0.2))
    assert peer.wait(peer_subscription, 1)[0] == {"data": "out"}


def test_the_yarp_worker_bridges_and_unregisters_its_ports(hubs: QuickHub, tmp_path: Path) -> None:
    names = Names()
    program = YarpProgram(names.client, "/program", Definitions(()))
    try:
        yarp = {"nameserver": "site", "address": names.endpoint, "poll": 0.1}
        with worker("yarp", hubs, tmp_path, yarp=yarp) as far:
            assert_crosses(far, program)
            assert "/midspan/from_side:i" in registered(names)
        until(
            lambda: not any(name.startswith("/midspan/") for name in registered(names)),
            "the worker's ports are unregistered",
        )
    finally:
        program.stop()
        names.stop()


def registered(names: Names) -> list[str]:
    return [contact.name for contact in names.client.list()]


def test_the_zenoh_worker_bridges_messages(hubs: QuickHub, tmp_path: Path) -> None:
    router = Router()
    bridge = Ros2ddsBridge(router.endpoint, Messages(ros1=False))
    try:
        zenoh = {"router": router.endpoint, "dialects": [{"dialect": "ros2dds"}]}
        with worker("zenoh", hubs, tmp_path, zenoh=zenoh) as far:
            assert_crosses(far, bridge)
    finally:
        bridge.stop()
        router.stop()

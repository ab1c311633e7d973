"""Fixtures of the contract suite. An adapter joins the suite with one line in ``SIDES``."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.hub.node import Hub
from bridge.interfaces.folders import read_folders
from bridge.messages.registry import Registry
from tests.contract.fakeside import FakeSide
from tests.contract.hubside import HubSide
from tests.contract.ownside import OwnSide
from tests.contract.plainside import PlainSide
from tests.contract.rmwside import RmwSide
from tests.contract.rmwzenohside import NODE, RmwZenohSide
from tests.contract.ros1side import EmbeddedMasterSide, Ros1AnyOsSide, Ros1Side
from tests.contract.ros2side import CycloneSide, KiltedSide, Ros2Side
from tests.contract.side import CUSTOM_FOLDER, OWN_FOLDER, PEER_FOLDERS, Bridge, Side
from tests.contract.yarpside import YarpSide
from tests.contract.zenohside import Ros1KeysSide, Ros2ddsSide
from tests.peers.hub.network import HubNetwork
from tests.peers.hub.quick import QuickHub
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, has_rmw_cyclonedds, ros2_python
from tests.peers.ros2.rmw_zenoh import has_rmw_zenoh, rmw_zenoh_environment
from tests.support.lane import LANE
from tests.support.missing import ROS1, lacking

SIDES: dict[str, type[Any]] = {
    "fake": FakeSide,
    "ros1": Ros1Side,
    "ros1_embedded_master": EmbeddedMasterSide,
    "ros1_any_os": Ros1AnyOsSide,
    "ros2": Ros2Side,
    "ros2_kilted": KiltedSide,
    "zenoh_ros2dds": Ros2ddsSide,
    "zenoh_ros1": Ros1KeysSide,
    "yarp": YarpSide,
    "own": OwnSide,
}
if has_rmw_cyclonedds():  # the wheels do not include it; see docs/sides/ros2.md
    SIDES["ros2_cyclone"] = CycloneSide
if ROS1 in lacking():
    SIDES["ros1_without_rospy"] = PlainSide

RELEASES = [release for release in ("jazzy", "kilted") if has_rmw_zenoh(release)]
"""Releases of ROS 2 that have rmw_zenoh_cpp here; their programs are further far ends."""


@pytest.fixture
def hubs() -> Iterator[HubNetwork]:
    with QuickHub() as network:
        yield network


APART = ("ros1_embedded_master", "ros2_kilted", "ros2_cyclone")
"""Sides that only `make test-all` runs."""

IN_TURN = (("ros1", "ros2", "own"), ("zenoh_ros2dds", "zenoh_ros1"))
"""Two groups, of sides with processes and of zenoh dialects; `make test` runs each test on one side of each group."""

ANY_OS = {
    "test_messages_of_the_side_arrive_on_the_hub_in_order",
    "test_messages_of_the_hub_arrive_on_the_side_in_order",
    "test_a_call_from_the_hub_reaches_a_server_on_the_side",
    "test_a_call_from_the_side_reaches_a_server_on_the_hub",
}
"""Tests of messages and calls that `make test` also runs on ``ros1_any_os``, which uses nothing that Windows lacks."""

BASIC = ANY_OS | {"test_the_newest_latched_messages_from_before_the_start_are_bridged"}
"""Tests that `make test` runs on every side."""

VARIANTS = ("ros1_any_os", "ros1_embedded_master", "ros2_kilted")
"""Sides that differ from ``ros1`` or ``ros2`` only in the operating system, the master, or the release of the peers."""

OF_ANY_VARIANT = ("test_rules.py", "test_bad_input.py", "test_best_available.py")
"""Files about decisions of the engine and policies of the hub, which variants of a side share."""


def _is_shown_elsewhere(item: pytest.Item) -> bool:
    """Return whether a test is redundant on a variant of a side, because it also runs on the side itself."""
    side, name = _param(item, "side"), getattr(item, "originalname", "")
    if _param(item, "far") and _param(item, "lane"):
        return True  # a real node is not on a lane
    if side == "ros1_any_os" and _param(item, "lane"):
        return True  # it cannot have a lane, because it has no Unix sockets
    if side == "ros1_embedded_master" and item.path.name == "test_latching.py" and name not in BASIC:
        return True  # a master has no part in latching
    return side in VARIANTS and item.path.name in OF_ANY_VARIANT


def _param(item: pytest.Item, name: str) -> Any:
    return item.callspec.params.get(name) if isinstance(item, pytest.Function) and hasattr(item, "callspec") else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Remove tests that are shown elsewhere, and mark those on all other sides as `thorough`."""
    folder = Path(__file__).parent
    items[:] = [item for item in items if item.path.parent != folder or not _is_shown_elsewhere(item)]
    for item in items:
        if item.path.parent == folder and isinstance(item, pytest.Function) and hasattr(item, "callspec"):
            side, turn = _param(item, "side"), zlib.crc32(item.originalname.encode())
            if side in APART or _param(item, "far") or (side == "ros1_any_os" and item.originalname not in ANY_OS):
                item.add_marker(pytest.mark.thorough)
            for sides in IN_TURN:
                if side in sides and side != sides[turn % len(sides)] and item.originalname not in BASIC:
                    item.add_marker(pytest.mark.thorough)


@pytest.fixture(params=list(SIDES))
def side(request: pytest.FixtureRequest, hubs: HubNetwork) -> Iterator[Side]:
    created = SIDES[request.param](hubs)
    try:
        yield created
    finally:
        created.close()


@pytest.fixture
def lane() -> bool:
    """Return whether small messages between the daemon's sessions, including the far end, bypass zenoh."""
    return LANE


@pytest.hookimpl(trylast=True)  # otherwise the tests have other names in a complete run, which loads this file later
def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run the tests of all sides without the lane, too, and with each far end."""
    if RELEASES and "far" in metafunc.fixturenames:
        metafunc.parametrize("far", ["", *RELEASES], ids=["far", *(f"rmw_zenoh_{r}" for r in RELEASES)], indirect=True)
    if metafunc.definition.originalname in BASIC:
        metafunc.parametrize("lane", [LANE, False] if LANE else [False], ids=["lane", "zenoh"] if LANE else ["zenoh"])


@pytest.fixture
def far(request: pytest.FixtureRequest, hubs: HubNetwork, tmp_path: Path, *, lane: bool) -> Iterator[HubSide]:
    """The far end of every route: an rmw_zenoh node, or, in tests of the lane, a session on the daemon's lanes."""
    folder = tmp_path / "state" / "contract" / "lane"
    hub = Hub.open(hubs.settings("far", lane=folder if lane else None))
    registry = Registry(folders=PEER_FOLDERS)
    release = getattr(request, "param", "")
    if release:
        end: HubSide = RmwZenohSide(hub, registry, _rmw_zenoh_program(hubs, release))
    elif hasattr(request.node, "callspec") and request.node.callspec.params.get("lane", False):
        end = HubSide(hub, registry)
    else:
        end = RmwSide(hub, registry, hubs.endpoint)
    try:
        yield end
    finally:
        end.close()


def _rmw_zenoh_program(hubs: HubNetwork, release: str) -> Peer:
    env = rmw_zenoh_environment(hubs.endpoint, hubs.domain, read_folders(PEER_FOLDERS), release)
    return Peer(ROS2_PEER, ros2_python(), env, NODE)


@pytest.fixture
def config(side: Side, hubs: HubNetwork, tmp_path: Path, *, lane: bool) -> Callable[..., Config]:
    """Return a function that creates configurations for the side: ``config(rules=[...], default="allow")``."""
    folders = [CUSTOM_FOLDER] if side.tells_empty_types else [CUSTOM_FOLDER, OWN_FOLDER]

    def make(**routing: Any) -> Config:
        return Config.model_validate(
            {
                "name": "contract",
                "state": str(tmp_path / "state"),
                "hub": {"listen": hubs.endpoint, "domain": hubs.domain, "lane": lane},
                "types": {"folders": [str(folder) for folder in folders]},
                "routing": routing,
                **side.config(),
            }
        )

    return make


@pytest.fixture
def bridge(side: Side, config: Callable[..., Config]) -> Bridge:
    """Start a worker with the default rules."""
    return side.bridge(config())

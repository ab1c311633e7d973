"""Two sessions on one hub, and a function that shares parameters between a roscore and the first of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from bridge.adapters.ros1.parameters import store as store_module
from bridge.adapters.ros1.parameters.follower import ParameterSharing
from bridge.adapters.ros1.parameters.store import ParameterServer
from bridge.config.sections.routing import ParameterRule
from bridge.hub.node import Hub
from tests.peers.hub.network import HubNetwork
from tests.peers.ros1.network import RosMaster
from tests.peers.ros1.parameters import PERIOD, REGISTRY, RecordingServer, Share


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a stop wait for the master, which may respond late on a busy machine; otherwise copies stay there."""
    monkeypatch.setattr(store_module, "_STOP_TIMEOUT", 4.0)


@pytest.fixture(scope="module")
def network() -> Iterator[HubNetwork]:
    with HubNetwork() as network:
        yield network


@pytest.fixture
def hubs(network: HubNetwork) -> Iterator[tuple[Hub, Hub]]:
    """The worker's session and another session."""
    with Hub.open(network.settings("midspan_ros1")) as ours, Hub.open(network.settings("others")) as others:
        yield ours, others


@pytest.fixture
def share(master: RosMaster, hubs: tuple[Hub, Hub]) -> Iterator[Share]:
    started: list[ParameterSharing] = []

    def start(
        *rules: ParameterRule, active: Callable[[], bool] = lambda: True, store: ParameterServer | None = None
    ) -> ParameterSharing:
        store = store or RecordingServer(master.uri)
        started.append(ParameterSharing(rules, hubs[0], REGISTRY, store, active, PERIOD))
        return started[-1]

    yield start
    for parameters in started:
        parameters.stop()

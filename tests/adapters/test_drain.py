"""A worker that is stopping still forwards navigation results, because a goal ends only once the robot stands."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters import worker as bridge_worker
from bridge.adapters.worker import BridgeWorker, NetworkBridge
from bridge.config.model import Config
from bridge.hub.endpoints.services import HubServer
from bridge.hub.node import Hub
from bridge.messages.actions import GoalState
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.calls import Calling, Serving
from tests.peers.hub.quick import QuickHub
from tests.support.wait import until

REGISTRY = Registry()
NAVIGATE, LOOKUP = "nav2_msgs/action/NavigateToPose", "tf2_msgs/action/LookupTransform"
GATEWAY, PLANNER = "/navigate_to_pose", "/planner/nav2/navigate_to_pose"
CANCELED = {"reply": {"status": int(GoalState.CANCELED)}}


class Side:
    """The worker of a side in this process, with programs on its network and on the hub."""

    def __init__(self, hubs: QuickHub, folder: Path) -> None:
        self.network = FakeNetwork()
        self.hub = Hub.open(hubs.settings("programs"))
        config = Config.model_validate({"name": "here", "state": folder, "hub": {"listen": hubs.endpoint}})
        edge = FakeEdge(self.network, REGISTRY)
        self.bridge = NetworkBridge("fake", edge, config, REGISTRY, self._failed, diagnostics=False)
        self.worker = BridgeWorker("ros2")
        self.worker.bridges = [self.bridge]
        self.servers: list[HubServer] = []
        self._began = 0.0
        self.seconds = 0.0
        self._thread: threading.Thread | None = None

    def _failed(self, reason: str) -> None:
        raise AssertionError(reason)

    def ask_hub(self, action: str, type_name: str = NAVIGATE) -> tuple[Serving, Calling]:
        """Request a pending result from an action server on the hub, as a program on the side does."""
        name, kind = f"{action}/_action/get_result", f"{type_name}_GetResult"
        serving = Serving(REGISTRY, kind, {"held": True, **CANCELED})
        self.servers.append(self.hub.server(name, kind, REGISTRY.service_ros2(kind).type_id, serving.call))

        def served() -> bool:
            return any(server.topic == name for server in self.network_servers())

        until(served, f"{name} is on the side")
        calling = Calling(REGISTRY, kind, {}, lambda request, done: self.network.call(name, request, done))
        assert serving.requests()
        return serving, calling

    def ask_side(self, action: str) -> tuple[Serving, Calling]:
        """Request a result from a planner's action on the side, as the gateway does."""
        name, kind = f"{action}/_action/get_result", f"{NAVIGATE}_GetResult"
        serving = Serving(REGISTRY, kind, {"held": True, **CANCELED})
        self.network.serve(name, kind, MadeBy.NATIVE, "/planner", serving.call)
        client = self.hub.client(name, kind, REGISTRY.service_ros2(kind).type_id)
        until(lambda: client.ready, f"{name} is on the hub")
        calling = Calling(REGISTRY, kind, {}, client.call)
        assert serving.requests()
        return serving, calling

    def network_servers(self) -> list[Any]:
        return [endpoint for endpoint in self.network.endpoints() if endpoint.made_by is MadeBy.MIDSPAN]

    def stop(self) -> None:
        """Begin to stop the worker."""
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        self.worker.stop()
        self.seconds = time.monotonic() - self._began

    @property
    def stopping(self) -> bool:
        """Return whether the worker is stopping and has not ended."""
        return not self.worker.bridges and self._thread is not None and self._thread.is_alive()

    def join(self) -> None:
        assert self._thread is not None
        self._thread.join(60)
        assert not self._thread.is_alive(), "the worker does not stop"

    def close(self) -> None:
        if self._thread is None:
            self.worker.stop()
        self.hub.close()


@pytest.fixture
def side(tmp_path: Path) -> Iterator[Side]:
    with QuickHub() as hubs, contextlib.closing(Side(hubs, tmp_path)) as new_side:
        yield new_side


def test_the_worker_forwards_the_end_of_a_gateway_goal_before_it_stops(
    side: Side, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On SIGTERM, the gateway stops the robot, and its clients on a side wait for the end of their goal."""
    monkeypatch.setattr(bridge_worker, "DRAIN_SECONDS", 60.0)
    serving, calling = side.ask_hub(GATEWAY)
    drained = watch_drain(monkeypatch)
    side.stop()
    assert drained.wait(20)
    assert side.stopping
    serving.release()  # the robot stands
    assert calling.result()["reply"]["status"] == GoalState.CANCELED
    side.join()


def test_the_worker_forwards_the_end_of_a_planner_goal_before_it_stops(
    side: Side, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bridge_worker, "DRAIN_SECONDS", 60.0)
    serving, calling = side.ask_side(PLANNER)
    drained = watch_drain(monkeypatch)
    side.stop()
    assert drained.wait(20)
    assert side.stopping
    serving.release()
    assert calling.result()["reply"]["status"] == GoalState.CANCELED
    side.join()


def test_results_of_other_actions_do_not_delay_the_stop(side: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_worker, "DRAIN_SECONDS", 120.0)
    _serving, calling = side.ask_hub("/lookup", LOOKUP)
    side.stop()
    side.join()
    assert calling.result()["error"]


def test_without_a_pending_result_the_worker_stops_at_once(side: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_worker, "DRAIN_SECONDS", 120.0)
    serving, calling = side.ask_hub(GATEWAY)
    serving.release()
    assert calling.result()["reply"]
    side.stop()
    side.join()


def test_a_robot_that_keeps_moving_delays_the_stop_only_until_the_deadline(
    side: Side, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bridge_worker, "DRAIN_SECONDS", 0.3)
    _serving, calling = side.ask_hub(GATEWAY)
    side.stop()
    side.join()
    assert 0.3 <= side.seconds < 60.0, "the worker waited for the deadline, and no longer"
    assert calling.result()["error"]


def watch_drain(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Return an event that is set once the worker has found a pending result."""
    drained, navigates = threading.Event(), bridge_worker._navigates

    def watched(route: Any) -> bool:
        pending = navigates(route)
        if pending:
            drained.set()
        return pending

    monkeypatch.setattr(bridge_worker, "_navigates", watched)
    return drained

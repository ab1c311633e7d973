"""Workers on a real hub: one serves prepared documents, and one has a real engine for an in-memory network."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import zenoh

from bridge.config.sections.routing import RoutingSection
from bridge.hub.daemons import DaemonIdentity
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.graph.tokens import MIDSPAN_SPACE
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from bridge.routing.engine import Engine
from tests.peers.fake import FakeEdge, FakeNetwork, Writer
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until
from yarp_compat.ports.sockets import closed_on_failure

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)


def route(topic: str, direction: str = "in", **more: Any) -> dict[str, Any]:
    """Return a route's entry in a status document."""
    return {
        "direction": direction, "topic": topic, "hub_topic": topic, "type": "sensor_msgs/msg/LaserScan",
        "side_type": "sensor_msgs/LaserScan", "priority": "stream", "state": "active", "sources": 1, "messages": 100,
        "bytes": 294000, "rate": 9.8, "age": 0.1, "latency_ms": {"p50": 0.31, "p99": 12.5},
        "drops": {"queue": 3, "rate": 0, "bad": 1}, "error": "", "qos": "reliable volatile 10", **more,
    }  # fmt: skip


def status(worker: str, **more: Any) -> dict[str, Any]:
    """Return a worker's status document."""
    return {
        "daemon": "robot1", "worker": worker, "side": worker, "pid": 4711, "zid": "ab", "network": "net-1",
        "state": "running", "uptime": 200.0, "cpu": 0.031, "rss": 52428800, "routes": [], "refused": [],
        "warnings": [], **more,
    }  # fmt: skip


class FakeWorker:
    """Serves prepared replies to any verb of the control plane."""

    def __init__(
        self, network: HubNetwork, worker: str, daemon: str = "robot1", identity: DaemonIdentity | None = None,
        **answers: Any,
    ) -> None:  # fmt: skip
        settings = network.settings(f"midspan_{worker}", worker=worker, daemon=daemon, identity=identity)
        self.hub = Hub.open(settings)
        self.endpoints: list[Any] = []
        with closed_on_failure(self.hub):
            for verb, answer in answers.items():
                self.hub.serve(verb, answer if callable(answer) else _constant(answer))
            _wait_until_routable(network, f"{daemon}/{worker}", answers)

    def publish(self, topic: str, type_name: str, type_hash: str, cdr: bytes) -> None:
        """Publish one latched message, which is retained until the worker is closed."""
        publisher = self.hub.publisher(topic, type_name, type_hash, LATCHED)
        self.endpoints.append(publisher)
        publisher.put(cdr)

    def subscribe(self, topic: str, type_name: str, qos: Qos) -> list[HubSample]:
        """Subscribe until the worker is closed; return a list that grows as samples arrive."""
        samples: list[HubSample] = []
        self.endpoints.append(self.hub.subscription(topic, type_name, "*", qos, samples.append))
        return samples

    def close(self) -> None:
        self.hub.close()


def _wait_until_routable(network: HubNetwork, worker_key: str, verbs: Iterable[str]) -> None:
    """Wait until the router knows all verbs of a worker, which is slightly after they are declared."""
    config = zenoh.Config()
    for key, value in (("mode", "client"), ("connect/endpoints", [network.endpoint])):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        for verb in verbs:
            querier = session.declare_querier(f"{MIDSPAN_SPACE}/{network.domain}/{worker_key}/{verb}")
            until(lambda querier=querier: querier.matching_status.matching, f"the router knows {verb} of {worker_key}")


def _constant(answer: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda _params: answer


class _Edge(FakeEdge):
    """A fake edge named ros1, so that names that concern only ROS 1 are withheld, such as /rosout."""

    side = "ros1"


class EngineWorker:
    """A real engine between the hub and an in-memory network, with the verbs that a bridge worker serves."""

    def __init__(self, network: HubNetwork, registry: Registry, **routing: Any) -> None:
        self.side = FakeNetwork()
        self.failures: list[str] = []
        self.hub = Hub.open(network.settings("midspan_ros1", worker="ros1", daemon="robot1"))
        edge = _Edge(self.side, registry)
        section = RoutingSection.model_validate(routing)
        self.engine = Engine(edge, self.hub, section, "robot1", self.failures.append)
        self.engine.start()
        verbs: dict[str, Callable[[dict[str, Any]], Any]] = {
            "status": lambda _params: {**status("ros1", pid=os.getpid()), **self.engine.status().document()},
            "explain": lambda params: self.engine.explain(params["topic"]),
            "tap": lambda params: self.engine.tap(params["topic"], params["seconds"]),
            "time": lambda _params: {"time_ns": time.time_ns()},
        }
        with closed_on_failure(self):
            for verb, handler in verbs.items():
                self.hub.serve(verb, handler)
            _wait_until_routable(network, "robot1/ros1", verbs)

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> Writer:
        qos = LATCHED if latched else Qos()
        return self.side.write_on(topic, type_name, qos, MadeBy.NATIVE, "/robot")

    def close(self) -> None:
        self.engine.stop()
        self.hub.close()


def config_file(folder: Path, network: HubNetwork, **sections: Any) -> Path:
    """Write a configuration file for this hub, and return its path (JSON is YAML)."""
    file = folder / "midspan.yaml"
    file.write_text(json.dumps({"name": "robot1", "hub": network.config(), **sections}))
    return file

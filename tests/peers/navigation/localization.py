"""A running LocalizationServer on the hub, with a robot in the laboratory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bridge.stores.kinds import MAP
from navigation.localization_server.estimate import POSE_COVARIANCE, spatial
from navigation.messages import pose_message
from navigation.pose import Pose, wrapped
from tests.peers.hub.modules import Place
from tests.peers.sim.laboratory import Robot
from tests.support.wait import until

OK = "localized_ok"


def started(place: Place, robot: Robot, **section: Any) -> None:
    """Start the module with the laboratory in the store; return when the module uses that map."""
    config = place.config(modules={"localization_server": {"enabled": True, "period": 0.05, **section}}, store={})
    place.worker.start(config)
    use(place, robot.grid.name, robot)
    until(lambda: status_of(place)["map"] == robot.grid.name, "the module uses the map", 20)


def use(place: Place, name: str, robot: Robot) -> None:
    robot.grid.m_map_name = name
    place.worker.store.put(MAP, name, robot.grid)
    place.worker.store.use_map(name)


def status_of(place: Place) -> Any:
    """Return the module's status document, a dictionary."""
    return place.answer("localization_server")


def messages_on(place: Place, topic: str) -> int:
    """Return how many messages the module has received on a topic."""
    return sum(end["messages"] for end in status_of(place)["topics"] if end["topic"] == topic)


def reports(place: Place, status: str, reason: str = "") -> Callable[[], bool]:
    """Return a function that checks whether the module reports a status, with a reason that contains ``reason``."""

    def check() -> bool:
        document = status_of(place)
        return document["localization"] == status and reason in document["reason"]

    return check


def near(place: Place, pose: Pose, meters: float = 0.15) -> Callable[[], bool]:
    """Return a function that checks whether the module's pose is within ``meters`` of ``pose``."""

    def check() -> bool:
        estimate = status_of(place).get("pose")
        return (
            bool(estimate) and pose.distance(Pose(*estimate)) < meters and abs(wrapped(estimate[2] - pose.theta)) < 0.1
        )

    return check


def start_publisher(place: Place, pose: Pose, covariance: Any = None, frame: str = "map") -> Callable[[], None]:
    """Return a function that publishes an initial pose."""
    out = place.far.advertise("/initialpose", POSE_COVARIANCE.replace("/msg", ""))
    covariance = np.zeros(36) if covariance is None else spatial(covariance)
    message = {
        "header": {"frame_id": frame},
        "pose": {"pose": pose_message(pose), "covariance": covariance.tolist()},
    }
    return lambda: place.far.publish(out, message)

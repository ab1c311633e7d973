"""The gateway of a deployment: its state, its services, and goals for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from bridge.client.errors import ClientError
from bridge.client.feed import latest_message
from bridge.client.services import ServiceCaller
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.config.sections.navigation import OURS
from bridge.status import StatusDocument, read_status
from bridge.text import clean
from navigation.constraints import Constraints
from navigation.nav2_errors import reason_text

STATUS_TOPIC, STATUS = "/navigation/status", "midspan_msgs/msg/NavigationStatus"
PATH = "nav_msgs/msg/Path"
PATIENCE = 5.0
"""Seconds to wait for a latched message."""

ANSWER_SECONDS = 10.0
"""Seconds to wait for a gateway on a busy machine; if there is no gateway, the query ends at once."""

_PATH_SECONDS = 1.0


class Navigation:
    """The gateway on the hub; the methods raise `ClientError` if it is missing or does not answer."""

    def __init__(self, client: Client, types: Types) -> None:
        self._client, self._types = client, types

    def status(self) -> dict[str, Any]:
        """Return the newest ``NavigationStatus``."""
        status = latest_message(self._client, self._types, STATUS_TOPIC, STATUS, PATIENCE)
        if status is None:
            raise ClientError(f"nothing is published on {STATUS_TOPIC}")
        return status

    def service(self, verb: str) -> ServiceCaller:
        """Return a client of one of the gateway's services, for example ``stop``, ``pause`` or ``resume``."""
        return ServiceCaller(self._client, self._types, f"/navigation/{verb}")

    def path(self, planner: str) -> list[dict[str, Any]]:
        """Return a planner's path as ``PoseStamped``, empty if it publishes none."""
        other = self._client.config.navigation.others.get(planner)
        topic = other.path if other is not None and other.path else f"/planner/{planner}/path"
        self._client.settle()
        if planner not in OURS and not self._client.publishers(topic):
            return []
        message = latest_message(self._client, self._types, topic, PATH, _PATH_SECONDS)
        return [] if message is None else list(message["poses"])


def gateway_document(client: Client) -> StatusDocument:
    """Return the gateway's status document; raises `ClientError` if no gateway answers."""
    for answer in client.ask("status", worker="gateway", timeout=ANSWER_SECONDS):
        if isinstance(answer.value, dict):
            return read_status(answer.value, answer.daemon, answer.worker)
    raise ClientError("no gateway answers")


def place_goal(location: ServiceCaller, name: str) -> dict[str, Any]:
    """Return a `NavigateToPose` goal for a stored place; ``location`` is a client of the service ``get_location``."""
    reply = location.ask({"name": name}, ANSWER_SECONDS)
    if not reply["success"]:
        raise ClientError(clean(reply["message"]))
    return {"pose": reply["pose"]}


def pose_goal(frame: str, numbers: Sequence[float]) -> dict[str, Any]:
    """Return a `NavigateToPose` goal for x, y (meters) and heading (degrees); with two numbers, any heading."""
    x, y, theta = (*numbers, 0.0)[:3]
    half = math.radians(theta) / 2.0
    pose = {"position": {"x": x, "y": y}, "orientation": {"z": math.sin(half), "w": math.cos(half)}}
    any_heading = {} if len(numbers) == 3 else {"behavior_tree": Constraints(heading=False).to_text()}
    return {"pose": {"header": {"frame_id": frame}, "pose": pose}, **any_heading}


def place_of(stamped: dict[str, Any]) -> tuple[str, float, float, float]:
    """Return the frame, x and y (meters) and heading (degrees) of a ``PoseStamped``."""
    from bridge.tf.transform import angles_of  # needs numpy, which most programs do without

    at, rotation = stamped["pose"]["position"], stamped["pose"]["orientation"]
    x, y, z, w = (rotation.get(axis, 0.0) for axis in "xyzw")
    return stamped["header"]["frame_id"], at["x"], at["y"], math.degrees(angles_of((x, y, z, w))[2])


def place_text(stamped: dict[str, Any], *, heading: bool = True) -> str:
    """Return a ``PoseStamped`` as text, with or without its heading."""
    frame, x, y, theta = place_of(stamped)
    return f"{x:.2f}, {y:.2f} m" + (f", {theta:.0f} degrees" if heading else "") + f" in {frame}"


def state_text(status: dict[str, Any]) -> str:
    """Return a ``NavigationStatus`` as text: the state and the reason."""
    state, reason = str(status["state"]).replace("_", " "), str(status["reason"])
    text = reason_text(reason, int(status.get("error_code", 0)))
    return f"{state}: {text}" if text else state

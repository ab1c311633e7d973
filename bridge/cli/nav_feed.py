"""How the gateway gets on, as verbs of the command line hear it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

from bridge.cli.calling import Caller
from bridge.cli.decode import Types
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client
from bridge.hub.qos import Durability, Qos
from bridge.hub.subscription import HubSample
from bridge.messages.errors import ConversionError
from navigation.maps.grid import yaw_of

STATUS_TOPIC, STATUS = "/navigation/status", "midspan_msgs/msg/NavigationStatus"
KEPT = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
PATIENCE = 5.0
"""Seconds within which what is kept for whoever joins is to come."""

NO_GATEWAY = "no gateway runs: name a planner in the section 'navigation' of the configuration"


class Latest:
    """The newest message of a topic that is kept for whoever joins.

    Args:
        client: the session.
        types: of the verb.
        topic: on the hub.
        type_name: of its messages.
        heard: gets each of them, on a thread of zenoh.
    """

    def __init__(
        self,
        client: Client,
        types: Types,
        topic: str,
        type_name: str,
        heard: Callable[[dict[str, Any]], None] = lambda _message: None,
    ) -> None:
        self._types, self._type, self._heard = types, type_name, heard
        self._hash = types.hash_of(type_name)
        self._came = threading.Event()
        self._message: dict[str, Any] | None = None
        self._end = client.hub.subscription(topic, type_name, self._hash, KEPT, self._take)

    def _take(self, sample: HubSample) -> None:
        try:
            self._message = self._types.decode(self._type, self._hash, sample.data())
        except (CliError, ConversionError):
            return
        self._heard(self._message)
        self._came.set()

    def wait(self, seconds: float) -> dict[str, Any] | None:
        """The message, waiting so long for the first one."""
        self._came.wait(seconds)
        return self._message

    def close(self) -> None:
        """Hear no more."""
        self._end.close()


def gateway_status(client: Client) -> dict[str, Any]:
    """The gateway's status document; raises `CliError` where there is no gateway."""
    for answer in client.ask("status"):
        if isinstance(answer.value, dict) and answer.worker == "gateway":
            return answer.value
    raise CliError(NO_GATEWAY)


def told_status(client: Client, types: Types) -> dict[str, Any]:
    """The newest ``NavigationStatus``; raises `CliError` where nobody tells one."""
    latest = Latest(client, types, STATUS_TOPIC, STATUS)
    try:
        found = latest.wait(PATIENCE)
    finally:
        latest.close()
    if found is None:
        raise CliError(f"nothing is told on {STATUS_TOPIC}: {NO_GATEWAY}")
    return found


def gateway_caller(client: Client, types: Types, name: str) -> Caller:
    """Calls one of the gateway's services; raises `CliError` where there is no gateway."""
    try:
        return Caller(client, types, name)
    except CliError as err:
        raise CliError(f"{err}\n{NO_GATEWAY}") from None


def place_of(stamped: dict[str, Any]) -> tuple[str, float, float, float]:
    """Frame, x and y (metres) and direction (degrees) of a ``PoseStamped``."""
    at, turn = stamped["pose"]["position"], stamped["pose"]["orientation"]
    return stamped["header"]["frame_id"], at["x"], at["y"], math.degrees(yaw_of(turn))


def place_text(stamped: dict[str, Any], *, heading: bool = True) -> str:
    """A ``PoseStamped`` in words, with its heading or without."""
    frame, x, y, theta = place_of(stamped)
    return f"{x:.2f}, {y:.2f} m" + (f", {theta:.0f} degrees" if heading else "") + f" in {frame}"


def state_text(status: dict[str, Any]) -> str:
    """A ``NavigationStatus`` in words: its state, and why."""
    state, reason = str(status["state"]).replace("_", " "), status["reason"]
    return f"{state}: {reason}" if reason else state

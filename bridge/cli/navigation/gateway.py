"""The gateway's state and answers, as verbs of the command line see them."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

from bridge.cli.client import CliClient
from bridge.cli.graph.caller import ServiceCaller
from bridge.cli.messages import Types
from bridge.cli.output import CliError
from bridge.daemon.query import Phase, ask_daemon
from bridge.doctor.hub_problems import Note, absence
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.wire.qos import LATCHED
from bridge.messages.errors import ConversionError
from navigation import nav2_errors

STATUS_TOPIC, STATUS = "/navigation/status", "midspan_msgs/msg/NavigationStatus"
PATIENCE = 5.0
"""Seconds within which what is kept for whoever joins is to come."""
_ANSWER = 10.0
"""Seconds that a gateway which is there has to answer, on a busy machine too; none that is not there is waited for."""

NO_GATEWAY = "no gateway runs: name a planner in the section 'navigation' of the configuration"


_LATE = (
    "the gateway's worker runs, and the gateway does not answer: the machine is busy, or it hangs; ask again, and see"
    " 'midspan status'"
)
_WORKER = "modules"


class LatestMessage:
    """The newest message of a latched topic; ``heard`` gets each message, on a thread of zenoh."""

    def __init__(
        self, client: CliClient, types: Types, topic: str, type_name: str,
        heard: Callable[[dict[str, Any]], None] = lambda _message: None,
    ) -> None:  # fmt: skip
        self._types, self._type, self._heard = types, type_name, heard
        self._hash = types.hash_of(type_name)
        self._came = threading.Event()
        self._message: dict[str, Any] | None = None
        self._end = client.hub.subscription(topic, type_name, self._hash, LATCHED, self._take)

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


def latest_message(
    client: CliClient, types: Types, topic: str, type_name: str, seconds: float
) -> dict[str, Any] | None:
    """The newest message of a latched topic, None where none comes in time."""
    latest = LatestMessage(client, types, topic, type_name)
    try:
        return latest.wait(seconds)
    finally:
        latest.close()


def gateway_status(client: CliClient) -> dict[str, Any]:
    """The gateway's status document; raises `CliError` where there is no gateway, or it does not answer."""
    for answer in client.ask("status", worker="gateway", timeout=_ANSWER):
        if isinstance(answer.value, dict):
            return answer.value
    raise CliError(no_answer(client))


def no_answer(client: CliClient) -> str:
    """Why no gateway answers: it is there and late, its worker is not up, or there is none."""
    client.settle()
    phase, text = _worker(client) if client.config.navigation.planner else ("", "")
    if phase == Phase.UP.value or client.hub.graph.publishers(STATUS_TOPIC):
        return _LATE
    return f"the gateway is not up: its worker '{_WORKER}' is {phase}: {text}" if phase else NO_GATEWAY


def _worker(client: CliClient) -> tuple[str, str]:
    """The phase of the gateway's worker and what it is at, as this machine's daemon says; "" where it has none."""
    for worker in (ask_daemon(client.config) or {}).get("workers", ()):
        if worker["worker"] == _WORKER:
            return worker["phase"], worker["text"]
    return "", ""


def planner_away(client: CliClient, gateway: dict[str, Any]) -> Note | None:
    """Why the planner is absent that a gateway waits for, by its status document; None where it waits for none."""
    if gateway.get("state") != "waiting":
        return None
    planner = str(gateway.get("planner"))
    if gateway.get("daemon") == client.config.name:  # another daemon's planners are in another configuration
        documents = [answer.value for answer in client.ask("status") if isinstance(answer.value, dict)]
        client.settle()
        found = absence(client.config.navigation, planner, client.hub.graph.endpoints(), documents)
        if found is not None:
            return found
    return Note(str(gateway.get("text") or f"the planner {planner} is not there"), "")


def told_status(client: CliClient, types: Types) -> dict[str, Any]:
    """The newest ``NavigationStatus``; raises `CliError` where nobody publishes one."""
    found = latest_message(client, types, STATUS_TOPIC, STATUS, PATIENCE)
    if found is None:
        raise CliError(f"nothing is published on {STATUS_TOPIC}: {no_answer(client)}")
    return found


def gateway_caller(client: CliClient, types: Types, name: str) -> ServiceCaller:
    """Calls one of the gateway's services; raises `CliError` where there is no gateway."""
    try:
        return ServiceCaller(client, types, name)
    except CliError as err:
        raise CliError(f"{err}\n{no_answer(client)}") from None


def place_of(stamped: dict[str, Any]) -> tuple[str, float, float, float]:
    """Frame, x and y (metres) and direction (degrees) of a ``PoseStamped``."""
    from navigation.maps.grid import yaw_of

    at, turn = stamped["pose"]["position"], stamped["pose"]["orientation"]
    return stamped["header"]["frame_id"], at["x"], at["y"], math.degrees(yaw_of(turn))


def place_text(stamped: dict[str, Any], *, heading: bool = True) -> str:
    """A ``PoseStamped`` in words, with its heading or without."""
    frame, x, y, theta = place_of(stamped)
    return f"{x:.2f}, {y:.2f} m" + (f", {theta:.0f} degrees" if heading else "") + f" in {frame}"


def state_text(status: dict[str, Any]) -> str:
    """Return a ``NavigationStatus`` as text: the state and the reason."""
    state, reason = str(status["state"]).replace("_", " "), str(status["reason"])
    text = reason_text(reason, int(status.get("error_code", 0)))
    return f"{state}: {text}" if text else state


def reason_text(reason: str, code: int) -> str:
    """Return a reason with the meaning of Nav2's error code, if the code is one of Nav2's and the reason lacks it."""
    meaning = nav2_errors.reason(code)
    if not meaning or f"Nav2 {code}" in reason:
        return reason
    if meaning in reason:
        return f"{reason} (Nav2 {code})"
    return f"{meaning} (Nav2 {code})" + (f": {reason}" if reason else "")

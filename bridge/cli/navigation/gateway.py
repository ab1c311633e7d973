"""The gateway's state and services, for the verbs of the command line."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

from bridge.cli.client import CliClient
from bridge.cli.graph.caller import ServiceCaller
from bridge.cli.messages import Types
from bridge.cli.output import CliError
from bridge.doctor.hub_problems import Note, absence
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.wire.qos import LATCHED
from bridge.messages.errors import ConversionError
from navigation.nav2_errors import reason_text

STATUS_TOPIC, STATUS = "/navigation/status", "midspan_msgs/msg/NavigationStatus"
PATIENCE = 5.0
"""Seconds within which a latched message arrives."""
_ANSWER = 10.0
"""Seconds that a gateway has to answer, also on a busy machine; without a gateway the question ends at once."""

NO_GATEWAY = "no gateway is configured: name a planner in the section 'navigation' of the configuration"
_LATE = (
    "the gateway's worker runs, but the gateway does not answer: the machine is busy, or the gateway hangs; ask again,"
    " and see 'midspan status'"
)
_WORKER = "modules"


class LatestMessage:
    """The newest message of a latched topic; ``on_message`` gets each message, on a thread of zenoh."""

    def __init__(
        self, client: CliClient, types: Types, topic: str, type_name: str,
        on_message: Callable[[dict[str, Any]], None] = lambda _message: None,
    ) -> None:  # fmt: skip
        self._types, self._type, self._on_message = types, type_name, on_message
        self._hash = types.hash_of(type_name)
        self._received = threading.Event()
        self._message: dict[str, Any] | None = None
        self._end = client.hub.subscription(topic, type_name, self._hash, LATCHED, self._on_sample)

    def _on_sample(self, sample: HubSample) -> None:
        try:
            self._message = self._types.decode(self._type, self._hash, sample.data())
        except (CliError, ConversionError):
            return
        self._on_message(self._message)
        self._received.set()

    def wait(self, seconds: float) -> dict[str, Any] | None:
        """Return the newest message, None if the first one does not arrive in time."""
        self._received.wait(seconds)
        return self._message

    def close(self) -> None:
        """Stop receiving messages."""
        self._end.close()


def latest_message(
    client: CliClient, types: Types, topic: str, type_name: str, seconds: float
) -> dict[str, Any] | None:
    """Return the newest message of a latched topic, None if it does not arrive in time."""
    latest = LatestMessage(client, types, topic, type_name)
    try:
        return latest.wait(seconds)
    finally:
        latest.close()


def gateway_status(client: CliClient) -> dict[str, Any]:
    """Return the gateway's status document; raises `CliError` without a gateway, or if it does not answer."""
    for answer in client.ask("status", worker="gateway", timeout=_ANSWER):
        if isinstance(answer.value, dict):
            return answer.value
    raise CliError(no_answer(client))


def check_daemon(client: CliClient) -> None:
    """Raise `CliError` if the daemon is down and no other one has a gateway: there is nothing to wait for."""
    state = client.daemon()
    if state.trouble:
        client.settle()
        if not client.hub.graph.publishers(STATUS_TOPIC):
            raise CliError(f"no gateway answers: {state.trouble}")


def no_answer(client: CliClient) -> str:
    """Return why no gateway answers: the daemon is down, none is configured, its worker does not run, or it is late."""
    documents = [answer.value for answer in client.ask("status") if isinstance(answer.value, dict)]
    state = client.daemon(documents)
    if state.trouble:
        return state.trouble
    client.settle()
    published = bool(client.hub.graph.publishers(STATUS_TOPIC))
    if not client.config.navigation.planner:
        return _LATE if published else NO_GATEWAY
    if missing := state.why_missing(_WORKER, client.config):
        return f"the gateway does not run: {missing}"
    report = next((str(worker["text"]) for worker in state.workers if worker["worker"] == _WORKER), None)
    if published or report is not None:
        return f"{_LATE} ({report})" if report and "gateway" in report else _LATE
    daemons = ", ".join(sorted({str(document.get("daemon")) for document in documents})) or "none"
    return f"no gateway runs on this hub: no daemon {client.config.name} runs on this machine; on the hub: {daemons}"


def planner_away(client: CliClient, gateway: dict[str, Any]) -> Note | None:
    """Return why the planner is absent that a gateway waits for, by its status document; None if it waits for none."""
    if gateway.get("state") != "waiting":
        return None
    planner = str(gateway.get("planner"))
    if gateway.get("daemon") == client.config.name:  # another daemon's planners are in another configuration
        documents = [answer.value for answer in client.ask("status") if isinstance(answer.value, dict)]
        client.settle()
        note = absence(client.config.navigation, planner, client.hub.graph.endpoints(), documents)
        if note is not None:
            return note
    return Note(str(gateway.get("text") or f"the planner {planner} is unreachable"), "")


def told_status(client: CliClient, types: Types) -> dict[str, Any]:
    """Return the newest ``NavigationStatus``; raises `CliError` if none is published."""
    check_daemon(client)
    status = latest_message(client, types, STATUS_TOPIC, STATUS, PATIENCE)
    if status is None:
        raise CliError(f"nothing is published on {STATUS_TOPIC}: {no_answer(client)}")
    return status


def gateway_caller(client: CliClient, types: Types, name: str) -> ServiceCaller:
    """Return a client of one of the gateway's services; raises `CliError` without a gateway."""
    check_daemon(client)
    try:
        return ServiceCaller(client, types, name)
    except CliError as err:
        raise CliError(f"{err}\n{no_answer(client)}") from None


def place_of(stamped: dict[str, Any]) -> tuple[str, float, float, float]:
    """Return the frame, x and y (meters) and heading (degrees) of a ``PoseStamped``."""
    from navigation.maps.grid import yaw_of

    at, turn = stamped["pose"]["position"], stamped["pose"]["orientation"]
    return stamped["header"]["frame_id"], at["x"], at["y"], math.degrees(yaw_of(turn))


def place_text(stamped: dict[str, Any], *, heading: bool = True) -> str:
    """Return a ``PoseStamped`` as text, with or without its heading."""
    frame, x, y, theta = place_of(stamped)
    return f"{x:.2f}, {y:.2f} m" + (f", {theta:.0f} degrees" if heading else "") + f" in {frame}"


def state_text(status: dict[str, Any]) -> str:
    """Return a ``NavigationStatus`` as text: the state and the reason."""
    state, reason = str(status["state"]).replace("_", " "), str(status["reason"])
    text = reason_text(reason, int(status.get("error_code", 0)))
    return f"{state}: {text}" if text else state

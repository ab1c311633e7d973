"""Clients of `tests.peers.navigation.mix`: one program on each side that sends the robot to goals."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from bridge.client.actions import SentGoal
from tests.contract.hubside import HubSide
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import ClientGoal, pose
from tests.peers.peer import Peer
from tests.support.wait import until
from yarp_compat.dev.inavigation2d import INavigation2DMsgs
from yarp_compat.dev.locations import Map2DLocation

SECONDS = 40.0
TRIGGER = "std_srvs/Trigger"
YARP, ROS1, ROS2, ZENOH = "YARP INavigation2D", "ROS 1 actionlib", "ROS 2 action", "zenoh (hub) action"
COMMAND = "midspan nav"
SILENT = "no answer"
"""The status that a client sees if its calls fail."""

_ENDS = {4: "succeeded", 5: "canceled", 6: "aborted"}
_STATUSES = {0: "unknown", 1: "accepted", 2: "executing", 3: "canceling", **_ENDS}

Answer = Callable[[], tuple[float, str] | None]
"""The reply to a stop or a pause: its time (monotonic), and "" for success or the reason; None until it arrives."""


class Caller(Protocol):
    """A program that can stop the robot."""

    def ask(self, word: str) -> Answer:
        """Request ``stop``, ``pause`` or ``resume`` without waiting for the reply."""


class Client(Caller, Protocol):
    """A program that sends the robot to goals."""

    def goto(self, x: float) -> None:
        """Send a goal on the x axis."""

    def progress(self) -> int:
        """Return how many progress reports have arrived."""

    def cancel(self) -> None:
        """Cancel the goal."""

    def seen(self) -> str:
        """Return the state that YARP reports, or the status of the action's goal."""

    def end(self) -> str:
        """Return how the goal ended, or "" if it has not ended."""

    def ended_at(self) -> float:
        """Return when the goal's end arrived (monotonic), or 0 if it has not arrived."""

    def why(self) -> str | None:
        """Return the reason for the end, or None if the protocol has no text for one."""


class YarpClient:
    """A client of INavigation2D."""

    def __init__(self, remote: INavigation2DMsgs, another: INavigation2DMsgs) -> None:
        self._remote, self._another = remote, another
        self._moving = 0

    def goto(self, x: float) -> None:
        assert self._remote.goto_target_by_absolute_location_RPC(Map2DLocation("map", x, 0.0, 0.0))
        self._moving = 0

    def progress(self) -> int:
        self._moving += self._state() == "moving"
        return self._moving

    def cancel(self) -> None:
        # repeated, because a stop that a busy machine does not confirm within 2.5 s is "not ok", and continues
        until(self._remote.stop_navigation_RPC, "the stop is confirmed", SECONDS)

    def ask(self, word: str) -> Answer:
        """Use a second connection, because the reply may take a while, and the status is polled meanwhile."""
        call = {
            "stop": self._another.stop_navigation_RPC,
            "pause": lambda: self._another.suspend_navigation_RPC(math.inf),
            "resume": self._another.resume_navigation_RPC,
        }[word]
        answers: list[tuple[float, str]] = []

        def run() -> None:
            try:
                answer = "" if call() else "not ok"
            except OSError as err:
                answer = f"{SILENT}: {err}"
            answers.append((time.monotonic(), answer))

        threading.Thread(target=run, daemon=True).start()
        return lambda: answers[0] if answers else None

    def seen(self) -> str:
        try:
            return self._state()
        except OSError:
            return SILENT

    def end(self) -> str:
        ends = {"goal_reached": "succeeded", "idle": "canceled", "aborted": "aborted"}
        return ends.get(self.seen(), "")

    def ended_at(self) -> float:
        return 0.0  # YARP reports states without times

    def why(self) -> None:
        return None

    def _state(self) -> str:
        return self._remote.get_navigation_status_RPC()[1].name.removeprefix("navigation_status_")


class RosClient:
    """A rospy or rclpy program with an action client, which also calls the gateway's services."""

    def __init__(self, peer: Peer, action: str, type_: str, field: str) -> None:
        self.peer, self._action, self._type, self._field = peer, action, type_, field
        self._goal = 0

    def goto(self, x: float, frame: str = "map") -> None:
        self.send(self._action, self._type, {self._field: pose(x, frame=frame)})

    def send(self, action: str, type_: str, goal: dict[str, Any]) -> None:
        """Send a goal of any action; from then on, the client's other methods refer to it."""
        self._goal = self.peer.ask("send_goal", action=action, type=type_, goal=goal, seconds=SECONDS)["id"]

    def progress(self) -> int:
        return len(self._state()["feedback"])

    def cancel(self) -> None:
        self.peer.ask("cancel", id=self._goal)

    def ask(self, word: str) -> Answer:
        call = self.peer.ask("call", service=f"/navigation/{word}", type=TRIGGER)["id"]

        def answer() -> tuple[float, str] | None:
            result = self.peer.ask("result", id=call, seconds=0.0)
            return (result["at"], _trouble(result)) if result["done"] else None

        return answer

    def seen(self) -> str:
        return _STATUSES[self._state()["status"]]

    def end(self) -> str:
        return _ENDS.get(self._state()["status"], "")

    def ended_at(self) -> float:
        return float(self._state()["ended_at"])

    def why(self) -> str:
        state = self._state()
        return str(state["text"] if "text" in state else (state["result"] or {}).get("error_msg", ""))

    def code(self) -> int:
        """Return the result's error code. actionlib has none."""
        return int((self._state()["result"] or {}).get("error_code", 0))

    def ends(self) -> int:
        """Return how many ends of the client's goal were reported."""
        return int(self._state()["ends"])

    def _state(self) -> dict[str, Any]:
        return self.peer.ask("goal", id=self._goal, seconds=0.0)


class _TimedGoal(ClientGoal):
    """A hub goal that records when its end arrived."""

    at = 0.0
    ends = 0

    def _end(self, goal: SentGoal, result: dict[str, Any] | None, why: str) -> None:
        self.at, self.ends = time.monotonic(), self.ends + 1
        super()._end(goal, result, why)


class ZenohClient:
    """A program on the hub."""

    def __init__(self, program: HubNode, far: HubSide) -> None:
        self._program, self._far = program, far
        self._goal: _TimedGoal | None = None

    @property
    def goal(self) -> _TimedGoal:
        """Return the last goal."""
        assert self._goal is not None
        return self._goal

    def goto(self, x: float) -> None:
        self._goal = _TimedGoal(self._program, pose(x))

    def progress(self) -> int:
        return len(self.goal.feedback)

    def cancel(self) -> None:
        self.goal.cancel()

    def ask(self, word: str) -> Answer:
        """Wait on a thread, in order to record the time of the reply."""
        answers: list[tuple[float, str]] = []
        call = self._far.call(f"/navigation/{word}", TRIGGER)

        def run() -> None:
            result = call.result(SECONDS)
            answers.append((time.monotonic(), _trouble(result)))

        threading.Thread(target=run, daemon=True).start()
        return lambda: answers[0] if answers else None

    def seen(self) -> str:
        return _STATUSES[int(self.goal.sent.status)]

    def end(self) -> str:
        return _ENDS.get(int(self.goal.sent.status), "") if self.goal.ended else ""

    def ended_at(self) -> float:
        return self.goal.at

    def why(self) -> str:
        return self.goal.end()[1]

    def ends(self) -> int:
        """Return how many ends of the client's goal were reported."""
        return self.goal.ends


class CommandLine:
    """The command ``midspan nav``."""

    def __init__(self, deployment: Deployment) -> None:
        self._deployment = deployment

    def ask(self, word: str) -> Answer:
        answers: list[tuple[float, str]] = []

        def run() -> None:
            command = ("halt",) if word == "halt" else ("nav", word)
            done = self._deployment.command(*command, seconds=60.0)
            text = f"exit code {done.returncode}: {done.stdout}{done.stderr}".strip()
            answers.append((time.monotonic(), text if done.returncode else ""))

        threading.Thread(target=run, daemon=True).start()
        return lambda: answers[0] if answers else None


def _trouble(result: dict[str, Any]) -> str:
    reply = result["reply"]
    if reply is None:
        return f"{SILENT}: {result['error']}"
    return "" if reply["success"] else str(reply["message"]) or f"{SILENT}: no success, and no message"

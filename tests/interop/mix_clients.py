"""Clients of `tests.interop.mix_table`: a program of each side that wants the robot somewhere."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any, Protocol

from tests.contract.hubside import HubSide
from tests.navigation.gateway.rig import Asked, Program, pose
from tests.support.peer import Peer
from yarp_compat.dev.inavigation2d import INavigation2DMsgs
from yarp_compat.dev.locations import Map2DLocation

SECONDS = 40.0
TRIGGER = "std_srvs/Trigger"
_ENDS = {4: "succeeded", 5: "canceled", 6: "aborted"}
_STATUSES = {0: "unknown", 1: "accepted", 2: "executing", 3: "canceling", **_ENDS}
SILENT = "no answer"
"""What a client sees whose calls fail."""

Answer = Callable[[], str | None]
"""What a stop was answered: "" where it is confirmed, else why not; None while there is no answer."""


class Client(Protocol):
    """A program of a side that wants the robot somewhere."""

    def goto(self, x: float) -> None:
        """Drive there."""

    def progress(self) -> int:
        """How much it has heard of its goal's progress."""

    def cancel(self) -> None:
        """Give the goal up."""

    def ask(self, word: str) -> bool:
        """``pause`` or ``resume``; whether that was done."""

    def stop(self) -> Answer:
        """Ask for a stop of whatever drives, beside other calls."""

    def seen(self) -> str:
        """How its goal gets on: YARP's state, or the status of the action's goal."""

    def end(self) -> str:
        """How the goal ended, "" while it has not."""

    def why(self) -> str | None:
        """What it heard of the reason; None where its protocol has no words for one."""


class YarpClient:
    """A client of INavigation2D."""

    def __init__(self, remote: INavigation2DMsgs, another: INavigation2DMsgs) -> None:
        self._remote, self._another = remote, another
        self._heard = 0

    def goto(self, x: float) -> None:
        assert self._remote.goto_target_by_absolute_location_RPC(Map2DLocation("map", x, 0.0, 0.0))
        self._heard = 0

    def progress(self) -> int:
        self._heard += self._state() == "moving"
        return self._heard

    def cancel(self) -> None:
        assert self._remote.stop_navigation_RPC()

    def ask(self, word: str) -> bool:
        call = {
            "pause": lambda: self._remote.suspend_navigation_RPC(math.inf),
            "resume": self._remote.resume_navigation_RPC,
        }
        return bool(call[word]())

    def stop(self) -> Answer:
        """By another connection: the answer may be waited for, and the status is asked for meanwhile."""
        said: list[str] = []

        def call() -> None:
            try:
                said.append("" if self._another.stop_navigation_RPC() else "not ok")
            except OSError as err:
                said.append(f"{SILENT}: {err}")

        threading.Thread(target=call, daemon=True).start()
        return lambda: said[0] if said else None

    def seen(self) -> str:
        try:
            return self._state()
        except OSError:
            return SILENT

    def end(self) -> str:
        ends = {"goal_reached": "succeeded", "idle": "canceled", "aborted": "aborted"}
        return ends.get(self.seen(), "")

    def why(self) -> None:
        return None

    def _state(self) -> str:
        return self._remote.get_navigation_status_RPC()[1].name.removeprefix("navigation_status_")


class RosClient:
    """A rospy or rclpy program with an action client, and calls of the gateway's services."""

    def __init__(self, peer: Peer, action: str, type_: str, field: str) -> None:
        self.peer, self._action, self._type, self._field = peer, action, type_, field
        self._goal = 0

    def goto(self, x: float, frame: str = "map") -> None:
        goal = {self._field: pose(x, frame=frame)}
        sent = self.peer.ask("send_goal", action=self._action, type=self._type, goal=goal, seconds=SECONDS)
        self._goal = sent["id"]

    def progress(self) -> int:
        return len(self._told()["feedback"])

    def cancel(self) -> None:
        self.peer.ask("cancel", id=self._goal)

    def ask(self, word: str) -> bool:
        call = self.peer.ask("call", service=f"/navigation/{word}", type=TRIGGER)["id"]
        reply = self.peer.ask("result", id=call, seconds=SECONDS)["reply"]
        return bool(reply and reply["success"])

    def stop(self) -> Answer:
        call = self.peer.ask("call", service="/navigation/stop", type=TRIGGER)["id"]
        return lambda: _answer(self.peer.ask("result", id=call, seconds=0.0))

    def seen(self) -> str:
        return _STATUSES[self._told()["status"]]

    def end(self) -> str:
        return _ENDS.get(self._told()["status"], "")

    def why(self) -> str:
        told = self._told()
        return str(told["text"] if "text" in told else told["result"]["error_msg"])

    def ends(self) -> int:
        """How often it was told that its goal has ended."""
        return int(self._told()["ends"])

    def _told(self) -> dict[str, Any]:
        return self.peer.ask("goal", id=self._goal, seconds=0.0)


class ZenohClient:
    """A program on the hub itself."""

    def __init__(self, program: Program, far: HubSide) -> None:
        self._program, self._far = program, far
        self._asked: Asked | None = None

    def goto(self, x: float) -> None:
        self._asked = Asked(self._program, pose(x))

    def progress(self) -> int:
        assert self._asked is not None
        return len(self._asked.feedback)

    def cancel(self) -> None:
        assert self._asked is not None
        self._asked.cancel()

    def ask(self, word: str) -> bool:
        return bool(self._far.call(f"/navigation/{word}", TRIGGER).result(SECONDS)["reply"]["success"])

    def stop(self) -> Answer:
        call = self._far.call("/navigation/stop", TRIGGER)
        return lambda: _answer(call.result(0.0))

    def seen(self) -> str:
        assert self._asked is not None
        return _STATUSES[int(self._asked.sent.status)]

    def end(self) -> str:
        assert self._asked is not None
        return _ENDS.get(int(self._asked.sent.status), "") if self._asked.ended else ""

    def why(self) -> str:
        assert self._asked is not None
        return self._asked.end()[1]


def _answer(told: dict[str, Any]) -> str | None:
    if not told["done"]:
        return None
    reply = told["reply"]
    if reply is None:
        return f"{SILENT}: {told['error']}"
    return "" if reply["success"] else str(reply["message"]) or f"{SILENT}: no success, and no words"

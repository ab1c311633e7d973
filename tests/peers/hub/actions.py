"""A program with actions on the hub: a module's node with the commands of `tests.peers.peer`."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Any

from bridge.clock import SYSTEM
from bridge.hub.session import Hub, HubSettings
from bridge.messages.registry import Registry
from bridge.modules.action_server import Goal
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop
from tests.support.wait import until


class Acting:
    """An action server: each goal publishes feedback, waits if held, and ends as configured."""

    def __init__(self, node: ModuleNode, params: dict[str, Any]) -> None:
        self._feedback, self._held = params.get("feedback") or [], bool(params.get("held"))
        self._outcome = params.get("outcome", "succeed")
        self._goals: list[Goal] = []
        self._changed = threading.Condition()
        node.action_server(params["action"], full(params["type"]), self._on_goal, self._cancel)
        self._loop = node.loop

    def _on_goal(self, goal: Goal) -> bool:
        if self._outcome == "reject":
            return False
        with self._changed:
            self._goals.append(goal)
            self._changed.notify_all()
        self._loop.post(lambda: self._run(goal))
        return True

    def _run(self, goal: Goal) -> None:
        goal.execute()
        for feedback in self._feedback:
            goal.feedback(feedback)
        if not self._held:
            self._end(goal)

    def _end(self, goal: Goal) -> None:
        (goal.abort if self._outcome == "abort" else goal.succeed)()

    def _cancel(self, goal: Goal) -> bool:
        self._loop.post(goal.canceled)
        return True

    def goals(self, count: int, seconds: float) -> list[dict[str, Any]]:
        with self._changed:
            self._changed.wait_for(lambda: len(self._goals) >= count, seconds)
            return [goal.goal for goal in self._goals]

    def release(self) -> None:
        self._held = False
        for goal in self._goals:
            self._loop.post(lambda goal=goal: self._end(goal))


class Sent:
    """A goal, with its received states, feedback and result."""

    def __init__(self, node: ModuleNode, params: dict[str, Any]) -> None:
        client = node.action_client(params["action"], full(params["type"]))
        until(lambda: client.ready, f"there is a server of {params['action']}", params["seconds"])
        self._feedback: list[dict[str, Any]] = []
        self._result: dict[str, Any] | None = None
        self._ended = False
        self._cancelled = False
        event = threading.Event()

        def send() -> None:
            self._goal = client.send(params["goal"], self._end, self._on_feedback)
            event.set()

        node.loop.post(send)
        assert event.wait(20)
        self._loop = node.loop

    def _on_feedback(self, feedback: dict[str, Any]) -> None:
        self._feedback.append(feedback)

    def _end(self, _status: Any, result: dict[str, Any] | None, _why: str) -> None:
        self._result, self._ended = result, True

    def cancel(self) -> None:
        self._loop.post(self._goal.cancel)
        self._cancelled = True

    def state(self) -> dict[str, Any]:
        status = int(self._goal.status) if self._ended else 0
        return {
            "accepted": self._goal.accepted,
            "feedback": self._feedback,
            "status": status,
            "result": self._result,
            "cancel": [0, 1] if self._cancelled and status == 5 else None,
        }


class HubActions:
    """The program."""

    def __init__(self, settings: HubSettings) -> None:
        self._loop = EventLoop("module")
        self._hub = Hub.open(settings)
        self._node = ModuleNode(self._hub, Registry(), self._loop, SYSTEM)
        self._loop.start()
        self._ends: list[Any] = []

    def ask(self, do: str, **params: Any) -> dict[str, Any]:
        """Execute a command."""
        if do in ("act", "send_goal"):
            self._ends.append((Acting if do == "act" else Sent)(self._node, params))
            return {"id": len(self._ends) - 1}
        end = self._ends[params["id"]]
        if do == "goals":
            return {"goals": end.goals(params.get("count", 1), params.get("seconds", 20.0))}
        if do == "goal":
            return waited(end.state, params["until"], params["seconds"])
        getattr(end, do)()
        return {}

    def stop(self) -> None:
        """Leave the hub."""
        self._node.close()
        self._loop.close()
        self._hub.close()


def waited(state: Callable[[], dict[str, Any]], wanted: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Return the state of a goal, once it has these fields (or this much feedback) or the time is over."""

    def there() -> bool:
        known = state()
        return all(len(known[k]) >= v if k == "feedback" else known[k] == v for k, v in wanted.items())

    with contextlib.suppress(AssertionError):  # the caller checks the state
        until(there, "the goal's state", seconds)
    return state()


def full(name: str) -> str:
    """Return ``package/Name`` in ROS 2's spelling of an action type."""
    package, _, short = name.partition("/")
    return f"{package}/action/{short}"

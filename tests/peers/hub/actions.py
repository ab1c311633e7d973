"""A program with actions on the hub: a module's node that executes the commands of `tests.peers.peer`."""

from __future__ import annotations

import contextlib
import threading
from typing import Any

from bridge.hub.session import HubSettings
from bridge.messages.registry import Registry
from bridge.modules.action_server import Goal
from bridge.modules.host import ModuleNode
from tests.peers.commands import Commands, Record
from tests.peers.hub.node import REGISTRY, HubNode
from tests.support.wait import until as wait_until


class Acting(Record):
    """An action server: it publishes each goal's feedback, waits if the goal is held, and ends it as ``outcome``."""

    def __init__(self, node: ModuleNode, params: dict[str, Any]) -> None:
        super().__init__(lambda goal: goal.goal)
        self._feedback, self._held = params.get("feedback") or [], bool(params.get("held"))
        self._outcome = params.get("outcome", "succeed")
        self._loop = node.loop
        node.action_server(params["action"], full(params["type"]), self._on_goal, self._cancel)

    def _on_goal(self, goal: Goal) -> bool:
        if self._outcome == "reject":
            return False
        self._loop.post(lambda: self._run(goal))  # before `add`, after which a test may release the goal
        self.add(goal)
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

    def release(self) -> None:
        self._held = False
        for goal in self.items:
            self._loop.post(lambda goal=goal: self._end(goal))


class PolledGoal:
    """A goal whose state is read only when needed."""

    def state(self) -> dict[str, Any]:
        """Return the goal's state, in the form of `tests.peers.commands.GoalRecord`."""
        raise NotImplementedError

    def wait(self, until: dict[str, Any], seconds: float) -> dict[str, Any]:
        """Return the state, once it has these values (at least as much feedback) or the time is over."""

        def reached() -> bool:
            state = self.state()
            return all(len(state[k]) >= v if k == "feedback" else state[k] == v for k, v in until.items())

        with contextlib.suppress(AssertionError):  # the caller checks the state
            wait_until(reached, "the goal's state", seconds)
        return self.state()


class Sent(PolledGoal):
    """A goal, with its received states, feedback and result."""

    def __init__(self, node: ModuleNode, params: dict[str, Any]) -> None:
        client = node.action_client(params["action"], full(params["type"]))
        wait_until(lambda: client.ready, f"there is a server of {params['action']}", params["seconds"])
        self._feedback: list[dict[str, Any]] = []
        self._result: dict[str, Any] | None = None
        self._ended = False
        self._canceled = False
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
        self._canceled = True

    def state(self) -> dict[str, Any]:
        status = int(self._goal.status) if self._ended else 0
        return {
            "accepted": self._goal.accepted,
            "feedback": self._feedback,
            "status": status,
            "result": self._result,
            "cancel": [0, 1] if self._canceled and status == 5 else None,
        }


class HubActions(Commands):
    """The program, which executes the commands."""

    def __init__(self, settings: HubSettings, registry: Registry = REGISTRY) -> None:
        super().__init__()
        self._program = HubNode(settings, registry)

    def act(self, **params: Any) -> dict[str, Any]:
        return self.add(Acting(self._program.node, params))

    def send_goal(self, **params: Any) -> dict[str, Any]:
        return self.add(Sent(self._program.node, params))

    def stop(self) -> None:
        """Leave the hub."""
        self._program.close()


def full(name: str) -> str:
    """Return ``package/Name`` in ROS 2's spelling of an action type."""
    package, _, short = name.partition("/")
    return f"{package}/action/{short}"

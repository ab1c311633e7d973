"""Action servers and clients of a bridge like zenoh-bridge-ros2dds, with the commands of `tests.peers.peer`.

Their only action is ``tf2_msgs/LookupTransform``, whose feedback has no fields.
"""

from __future__ import annotations

import threading
from typing import Any

from tests.peers.commands import Commands
from tests.peers.hub.actions import PolledGoal
from tests.peers.zenoh.actions import ABORTED, CANCELED, EXECUTING, SUCCEEDED, ActionClient, ActionServer
from tests.peers.zenoh.programs import Ros2ddsBridge
from tests.peers.zenoh.services import Calling
from tests.support.wait import until


class Acting:
    """An action server that accepts one goal, and ends it as configured."""

    def __init__(self, bridge: Ros2ddsBridge, params: dict[str, Any]) -> None:
        self._server = ActionServer(bridge, params["action"])
        self._outcome, self._held = params.get("outcome", "succeed"), bool(params.get("held"))
        self._seconds = params["seconds"]
        self._thread: threading.Thread | None = None
        self._server.send_goal.reply = {"accepted": self._outcome != "reject"}
        if self._outcome != "reject":
            self._server.send_goal.held = True  # until the reply to a cancel request names the goal
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()

    def _run(self) -> None:
        if not self._server.send_goal.requests(1, self._seconds):
            return
        self._server.cancel_goal.reply = {"goals_canceling": [{"goal_id": self._server.goal()["goal_id"]}]}
        self._server.send_goal.release()
        until(lambda: self._server.feedback.matching_status.matching, "a client matches", self._seconds)  # type: ignore[attr-defined]
        self._server.report(EXECUTING)
        if not self._held:
            self._end(ABORTED if self._outcome == "abort" else SUCCEEDED)
        elif self._server.cancel_goal.requests(1, self._seconds):
            self._end(CANCELED)

    def _end(self, status: int) -> None:
        if self._server.get_result.requests(1, self._seconds):
            self._server.end(status, "laser")

    def wait(self, count: int, seconds: float) -> list[dict[str, Any]]:
        """Return the received goals, after ``count`` have arrived or the time is over."""
        return [request["goal"] for request in self._server.send_goal.requests(count, seconds)]

    def release(self) -> None:
        """End the held goal."""
        self._end(SUCCEEDED)

    def close(self) -> None:
        """Leave the network."""
        self._server.close()
        if self._thread is not None:
            self._thread.join(self._seconds)


class Sent(PolledGoal):
    """A goal, with its received states, feedback and result."""

    def __init__(self, bridge: Ros2ddsBridge, number: int, params: dict[str, Any]) -> None:
        self._client = ActionClient(bridge, params["action"])
        self._id = {"goal_id": {"uuid": [number] * 16}}
        request = {**self._id, "goal": params["goal"]}
        until(lambda: bridge.tokens(params["action"], "AS"), f"{params['action']} is announced", params["seconds"])

        def answered() -> Any:
            """Return the reply; the plugin's client gets no reply before the other side's server exists."""
            return self._client.ask("send_goal", request).result()["reply"]

        reply = until(answered, f"there is a server of {params['action']}", params["seconds"], every=0.1)
        self._accepted: bool = reply["accepted"]
        self._result: Calling | None = self._client.ask("get_result", self._id) if self._accepted else None
        self._canceled: Calling | None = None

    def cancel(self) -> None:
        """Request the goal's cancellation."""
        self._canceled = self._client.ask("cancel_goal", {"goal_info": self._id})

    def state(self) -> dict[str, Any]:
        """Return the state of the goal."""
        ended = None if self._result is None else self._result.result(0)["reply"]
        reported = None if self._canceled is None else self._canceled.result(0)["reply"]
        return {
            "accepted": self._accepted,
            "feedback": [item["feedback"] for item in self._client.feedback],
            "status": ended["status"] if ended else 0,
            "result": ended["result"] if ended else None,
            "cancel": [reported["return_code"], len(reported["goals_canceling"])] if reported else None,
        }

    def close(self) -> None:
        """Leave the network."""
        if self._result is not None:
            self._result.token.cancel()
        self._client.close()


class Ros2ddsActions(Commands):
    """Nodes with action servers and clients that one bridge connects.

    Args:
        bridge: their bridge.
        seconds: how long a server waits for a goal.
    """

    def __init__(self, bridge: Ros2ddsBridge, seconds: float) -> None:
        super().__init__()
        self._bridge, self._seconds = bridge, seconds

    def act(self, **params: Any) -> dict[str, Any]:
        return self.add(Acting(self._bridge, {"seconds": self._seconds, **params}))

    def send_goal(self, **params: Any) -> dict[str, Any]:
        return self.add(Sent(self._bridge, len(self.parts) + 1, {"seconds": self._seconds, **params}))

    def stop(self) -> None:
        """Leave the network."""
        for part in self.parts.values():
            part.close()

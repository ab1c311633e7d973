"""Services and actions of the rclpy program `tests.peers.ros2.peer`; see `tests.peers.peer` for the commands."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from tests.peers.commands import GoalRecord, Record

Fill = Callable[[Any, dict[str, Any]], Any]
Plain = Callable[[Any], Any]


def type_class(name: str, folder: str) -> Any:
    """Return the class of a service or action spelled ``package/Name``."""
    package, _, short = name.rpartition("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), short)


class Serving(Record):
    """A service with one answer to all requests, or none if it has an ``error``, because ROS 2 has no error replies."""

    def __init__(self, node: Any, params: dict[str, Any], profile: Any, fill: Fill, plain: Plain) -> None:
        super().__init__()
        self.node, self.fill, self.plain = node, fill, plain
        self.reply, self.error = params.get("reply") or {}, params.get("error", "")
        self.echo = params.get("echo", {})
        self.held: Any = Future()
        if not params.get("held"):
            self.held.set_result(None)
        if self.error:
            self.held = Future()
        self.handle = node.create_service(
            type_class(params["type"], "srv"),
            params["service"],
            self.asked,
            qos_profile=profile,
            callback_group=ReentrantCallbackGroup(),
        )

    async def asked(self, request: Any, response: Any) -> Any:
        self.add(self.plain(request))
        if not self.held.done():
            await self.held
        for target, source in self.echo.items():
            setattr(response, target, getattr(request, source))
        return self.fill(response, self.reply)

    def release(self) -> None:
        if not self.error and not self.held.done():
            self.held.set_result(None)
            self.node.executor.wake()  # setting a future's result does not wake the executor

    def drop(self) -> None:
        self.node.destroy_service(self.handle)


class Calling:
    """Concurrent calls of one service, and their replies in the order of the calls."""

    def __init__(self, client: Any, requests: list[Any], plain: Plain) -> None:
        self.plain = plain
        self.done = threading.Event()
        self.at = 0.0
        self.left = len(requests)
        self.lock = threading.Lock()
        self.futures = [client.call_async(request) for request in requests]
        for future in self.futures:
            future.add_done_callback(self.on_reply)

    def on_reply(self, _future: Any) -> None:
        with self.lock:
            self.left -= 1
            if not self.left:
                self.at = time.monotonic()
                self.done.set()

    def result(self, seconds: float) -> dict[str, Any]:
        done = self.done.wait(seconds)
        replies = [self.plain(future.result()) if future.done() else None for future in self.futures]
        return {"done": done, "reply": replies[0], "replies": replies, "error": "", "at": self.at}

    def drop(self) -> None:
        """Do nothing, because other calls use the client."""


def depths(profile: Any, *parts: str) -> dict[str, Any]:
    """Return a profile for each of these parts of an action."""
    return {f"{part}_qos_profile": profile for part in parts}


class Acting(Record):
    """An action server: it publishes each goal's feedback, waits if the goal is held, and ends it as ``outcome``."""

    def __init__(self, node: Any, params: dict[str, Any], profile: Any, fill: Fill, plain: Plain) -> None:
        super().__init__()
        self.node, self.fill, self.plain = node, fill, plain
        self.type = type_class(params["type"], "action")
        self.feedback, self.result = params.get("feedback") or [], params.get("result") or {}
        self.outcome, self.held, self.keeps = params.get("outcome", "succeed"), params.get("held"), params.get("keeps")
        self.times, self.period = params.get("times", 1), params.get("period", 0.0)
        self.waits: dict[bytes, Any] = {}
        self.name = params["action"]
        self.handle = ActionServer(
            node,
            self.type,
            self.name,
            self.execute,
            **depths(profile, "goal_service", "result_service", "cancel_service", "feedback_pub"),
            goal_callback=lambda _goal: GoalResponse.REJECT if self.outcome == "reject" else GoalResponse.ACCEPT,
            cancel_callback=self.canceled,
        )

    async def execute(self, handle: Any) -> Any:
        wait = self.waits.setdefault(bytes(handle.goal_id.uuid), Future())  # before `release` may end the goals
        self.add(self.plain(handle.request))
        if self.period:
            threading.Thread(target=self.work, args=(handle,), daemon=True).start()
        else:
            self.work(handle)
        if self.held or self.period:
            await wait
        if handle.is_cancel_requested:
            handle.canceled()
        elif self.outcome == "abort":
            handle.abort()
        else:
            handle.succeed()
        return self.fill(self.type.Result(), self.result)

    def work(self, handle: Any) -> None:
        self._matched()
        due = time.monotonic()
        for _ in range(self.times):
            for fields in self.feedback:
                handle.publish_feedback(self.fill(self.type.Feedback(), fields))
            due += self.period
            time.sleep(max(0.0, due - time.monotonic()))
        if self.period and not self.held:
            self.end(bytes(handle.goal_id.uuid))

    def _matched(self) -> None:
        """Wait for a subscriber to feedback: a goal can arrive before its client's subscription is discovered."""
        end = time.monotonic() + 5.0
        feedback = self.node.resolve_topic_name(self.name) + "/_action/feedback"
        while self.feedback and not self.node.count_subscribers(feedback) and time.monotonic() < end:
            time.sleep(0.01)

    def canceled(self, handle: Any) -> Any:
        if self.keeps:
            return CancelResponse.REJECT
        self.end(bytes(handle.goal_id.uuid))
        return CancelResponse.ACCEPT

    def end(self, goal: bytes) -> None:
        wait = self.waits.setdefault(goal, Future())
        if not wait.done():
            wait.set_result(None)
        self.node.executor.wake()  # setting a future's result does not wake the executor

    def release(self) -> None:
        self.held = False
        for goal in list(self.waits):
            self.end(goal)

    def drop(self) -> None:
        self.release()
        self.handle.destroy()


def on_executor(node: Any, work: Callable[[], None]) -> None:
    """Run a function on the thread that handles replies, and wait for it.

    rclpy's action client (7.1) sends a request before it registers that it waits for the reply. If another thread
    handles the reply in between, rclpy drops the reply as unexpected, and the request never completes.
    """
    done = threading.Event()

    def run() -> None:
        try:
            work()
        finally:
            done.set()

    node.executor.create_task(run)
    done.wait(20.0)


class Goal(GoalRecord):
    """A goal of an action client."""

    def __init__(self, node: Any, client: ActionClient, goal: Any, plain: Plain) -> None:
        super().__init__()
        self.node, self.plain = node, plain
        self.handle: Any = None

        def send() -> None:
            client.send_goal_async(goal, feedback_callback=self.on_feedback).add_done_callback(self.answered)

        on_executor(node, send)

    def on_feedback(self, message: Any) -> None:
        self.add_feedback(self.plain(message.feedback))

    def answered(self, future: Any) -> None:
        self.handle = future.result()
        self.update(accepted=self.handle.accepted)
        if self.handle.accepted:
            self.ask()

    def ask(self) -> None:
        """Request the result."""
        self.handle.get_result_async().add_done_callback(self.ended)

    def ended(self, future: Any) -> None:
        answer = future.result()
        changed = answer.status != self.state["status"]  # the same result may be requested again
        at = time.monotonic() if changed else self.state["ended_at"]
        ends = self.state["ends"] + changed
        self.update(status=answer.status, result=self.plain(answer.result), ends=ends, ended_at=at)

    def cancel(self) -> None:
        def on_answer(future: Any) -> None:
            answer = future.result()
            self.update(cancel=[answer.return_code, len(answer.goals_canceling)])

        on_executor(self.node, lambda: self.handle.cancel_goal_async().add_done_callback(on_answer))

    def drop(self) -> None:
        """Do nothing, because other calls use the client."""

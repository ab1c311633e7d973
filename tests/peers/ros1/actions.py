"""Actions of the rospy program `tests.peers.ros1.peer`; see `tests.peers.peer` for the commands.

Runs on the system's Python. A goal's ``status`` and ``cancel`` have ROS 2's values; see docs/sides/actions.md.
"""
# ruff: noqa: ANN204  # it runs without Midspan

import threading
import time

import actionlib
from actionlib.action_client import CommState
from actionlib_msgs.msg import GoalStatus

from tests.peers.commands import GoalRecord, Record
from tests.peers.ros1.message_types import message_class

STATUSES = {
    GoalStatus.SUCCEEDED: 4, GoalStatus.PREEMPTED: 5, GoalStatus.RECALLED: 5, GoalStatus.ABORTED: 6, GoalStatus.LOST: 6,
}  # fmt: skip


def part(type_, name):
    """Return one of an action's message classes."""
    return message_class(type_ + name)


class Acting(Record):
    """An action server: it publishes each goal's feedback, waits if the goal is held, and ends it as ``outcome``."""

    def __init__(self, params, fill, plain):
        super().__init__()
        self.fill, self.plain, self.type = fill, plain, params["type"]
        self.feedback, self.result = params.get("feedback") or [], params.get("result") or {}
        self.outcome, self.held, self.keeps = params.get("outcome", "succeed"), params.get("held"), params.get("keeps")
        self.times, self.period = params.get("times", 1), params.get("period", 0.0)
        self.handles = []
        action = part(self.type, "Action")
        self.server = actionlib.ActionServer(params["action"], action, self.on_goal, self.on_cancel, auto_start=False)
        self.server.start()

    def on_goal(self, handle):
        self.handles.append(handle)
        self.add(self.plain(handle.get_goal()))
        if self.outcome == "reject":
            handle.set_rejected()
            return
        handle.set_accepted()
        if self.period:
            threading.Thread(target=self.work, args=(handle,), daemon=True).start()
            return
        self.work(handle)

    def work(self, handle):
        due = time.monotonic()
        for _ in range(self.times):
            for fields in self.feedback:
                handle.publish_feedback(self.fill(part(self.type, "Feedback")(), fields))
            due += self.period
            time.sleep(max(0.0, due - time.monotonic()))
        if not self.held:
            self.end(handle)

    def on_cancel(self, handle):
        if not self.keeps:
            handle.set_canceled(self.filled())

    def end(self, handle):
        (handle.set_aborted if self.outcome == "abort" else handle.set_succeeded)(self.filled())

    def filled(self):
        return self.fill(part(self.type, "Result")(), self.result)

    def release(self):
        self.held = False
        for handle in self.handles:
            if handle.get_goal_status().status in (GoalStatus.ACTIVE, GoalStatus.PREEMPTING):
                self.end(handle)

    def drop(self):
        self.release()
        self.server.stop()


class Goal(GoalRecord):
    """A goal of an action client."""

    def __init__(self, client, goal, plain):
        super().__init__()
        self.plain, self.handle = plain, None
        self.handle = client.send_goal(goal, self.changed, lambda _handle, feedback: self.add_feedback(plain(feedback)))

    def changed(self, handle):
        state, status = handle.get_comm_state(), handle.get_goal_status()
        if state in (CommState.RECALLING, CommState.PREEMPTING):
            self.update(cancel=[0, 1])
        if state == CommState.DONE:
            result = handle.get_result()
            known = None if result is None else self.plain(result)
            accepted, ends = status != GoalStatus.REJECTED, self.state["ends"] + 1
            self.update(
                status=STATUSES.get(status, 0),
                accepted=accepted,
                ends=ends,
                ended_at=time.monotonic(),
                text=handle.get_goal_status_text(),
                result=known,
            )
        elif state in (CommState.PENDING, CommState.ACTIVE) and status != GoalStatus.REJECTED:
            self.update(accepted=True)

    def cancel(self):
        self.handle.cancel()

    def drop(self):
        """Do nothing, because other goals use the client."""


def action_client(action, type_):
    """Return a client of an action."""
    return actionlib.ActionClient(action, part(type_, "Action"))

"""Actions of the rospy program `tests.peers.ros1.peer`; see `tests.peers.peer` for the commands.

Runs on the system's Python. A goal's ``status`` and ``cancel`` are as ROS 2's: see docs/sides/actions.md.
"""
# ruff: noqa: ANN003, ANN202, ANN204  # it runs without Midspan

import threading
import time

import actionlib
from actionlib.action_client import CommState
from actionlib_msgs.msg import GoalStatus
from message_types import message_class
from rospy import Duration

STATUSES = {
    GoalStatus.SUCCEEDED: 4, GoalStatus.PREEMPTED: 5, GoalStatus.RECALLED: 5, GoalStatus.ABORTED: 6, GoalStatus.LOST: 6,
}  # fmt: skip


def part(type_, name):
    """Return one of an action's message classes."""
    return message_class(type_ + name)


class Acting:
    """An action server: each goal gives its feedback, waits if it is held, and ends with the given outcome."""

    def __init__(self, params, fill, plain):
        self.fill, self.plain, self.type = fill, plain, params["type"]
        self.feedback, self.result = params.get("feedback") or [], params.get("result") or {}
        self.outcome, self.held, self.keeps = params.get("outcome", "succeed"), params.get("held"), params.get("keeps")
        self.times, self.period = params.get("times", 1), params.get("period", 0.0)
        self.goals, self.handles, self.arrived = [], [], threading.Condition()
        action = part(self.type, "Action")
        self.server = actionlib.ActionServer(params["action"], action, self.on_goal, self.on_cancel, auto_start=False)
        self.server.start()

    def on_goal(self, handle):
        with self.arrived:
            self.goals.append(self.plain(handle.get_goal()))
            self.handles.append(handle)
            self.arrived.notify_all()
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

    def wait(self, count, seconds):
        with self.arrived:
            self.arrived.wait_for(lambda: len(self.goals) >= count, seconds)
            return list(self.goals)

    def release(self):
        self.held = False
        for handle in self.handles:
            if handle.get_goal_status().status in (GoalStatus.ACTIVE, GoalStatus.PREEMPTING):
                self.end(handle)

    def unregister(self):
        self.release()
        self.server.stop()


class Goal:
    """A goal of an action client, with its feedback and result."""

    def __init__(self, client, goal, plain):
        self.plain, self.news, self.handle = plain, threading.Condition(), None
        self.state = {"accepted": None, "feedback": [], "status": 0, "result": None, "cancel": None, "ends": 0}
        self.state["ended_at"] = 0.0
        self.handle = client.send_goal(goal, self.changed, self.on_feedback)

    def update(self, **news):
        with self.news:
            self.state.update(news)
            self.news.notify_all()

    def on_feedback(self, _handle, feedback):
        self.update(feedback=[*self.state["feedback"], self.plain(feedback)])

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

    def wait(self, until, seconds):
        """Return the state, once each field of ``until`` has its value (feedback: at least that many)."""

        def reached():
            state = {**self.state, "feedback": len(self.state["feedback"])}
            return all(state[k] >= v if k == "feedback" else state[k] == v for k, v in until.items())

        with self.news:
            self.news.wait_for(reached, seconds)
            return dict(self.state)

    def unregister(self):
        """Do nothing: the client stays for other goals."""


class Actions:
    """The action commands of the peer."""

    def __init__(self, fill, plain):
        self.fill, self.plain, self.clients = fill, plain, {}

    def act(self, params):
        return Acting(params, self.fill, self.plain)

    def send_goal(self, params):
        key = params["action"], params["type"]
        if key not in self.clients:
            self.clients[key] = actionlib.ActionClient(key[0], part(key[1], "Action"))
        client = self.clients[key]
        assert client.wait_for_server(Duration(params.get("seconds", 40.0))), f"no server of {key[0]}"
        return Goal(client, self.fill(part(key[1], "Goal")(), params.get("goal") or {}), self.plain)

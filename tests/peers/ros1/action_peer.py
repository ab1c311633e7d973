"""A real rospy program with actionlib clients and servers, driven with JSON lines as in `tests.peers.peer`.

Runs on the system's Python. Actions are ``actionlib/TestAction`` (goal, feedback and result an int32 each) unless
another type is named. Usage: action_peer.py NODE

A goal's number determines how an ``ActionServer`` here handles it; see `OUTCOMES`. A held goal waits for ``finish``.
A cancel request ends a goal as canceled, unless its number is 1,000,000 or more.
"""
# ruff: noqa: A002, ANN003, ANN204, ARG002  # parameters are named as in the commands; it runs without Midspan

import signal
import sys
import threading
from pathlib import Path

import actionlib
import roslib.message
import rospy
from actionlib.action_client import CommState
from actionlib_msgs.msg import GoalID, GoalStatus

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.commands import Commands, Record, only_answers, serve
from tests.peers.ros1.connector import Connector
from tests.peers.ros1.shutdown import shut_down
from tests.support.wait import until

ENDED = (GoalStatus.PREEMPTED, GoalStatus.SUCCEEDED, GoalStatus.ABORTED, GoalStatus.REJECTED, GoalStatus.RECALLED)
OUTCOMES = ("succeed", "abort", "reject", "preempt", "hold")
"""The outcome of a goal, by its number modulo 10; goals with other numbers are held."""


def action_class(type):
    return roslib.message.get_message_class(type + "Action")


def to_plain(value):
    """Return a message as JSON values."""
    return {n: to_plain(getattr(value, n)) for n in value.__slots__} if hasattr(value, "__slots__") else value


class Server(Record):
    """An actionlib.ActionServer that acts on each goal according to its number."""

    def __init__(self, name, type):
        super().__init__()
        self.type, self.handles = type, {}
        self.free = threading.Event()
        self.free.set()
        self.server = actionlib.ActionServer(name, action_class(type), self.on_goal, self.on_cancel, auto_start=False)
        self.server.start()

    def on_goal(self, handle):
        goal_id, goal = handle.get_goal_id().id, handle.get_goal()
        number = getattr(goal, "goal", None)
        self.handles[goal_id] = handle
        self.add((goal_id, to_plain(goal) if number is None else number))
        if number is None:
            handle.set_accepted()
            return
        outcome = OUTCOMES[number % 10] if number % 10 < len(OUTCOMES) else "hold"
        if outcome == "reject":
            handle.set_rejected(self.result(-number), "no")
            return
        handle.set_accepted("yes")
        handle.publish_feedback(self.message("Feedback", feedback=number))
        if outcome != "hold":
            self.finish(goal_id, outcome)
        self.free.wait()

    def finish(self, id, outcome):
        handle = self.handles[id]
        result = self.result(handle.get_goal().goal)
        {"succeed": handle.set_succeeded, "abort": handle.set_aborted, "preempt": handle.set_canceled}[outcome](
            result, outcome
        )

    def on_cancel(self, handle):
        if handle.get_goal().goal < 1_000_000:
            handle.set_canceled(self.result(handle.get_goal().goal), "canceled")

    def message(self, part, **fields):
        return roslib.message.get_message_class(self.type + part)(**fields)

    def result(self, number):
        return self.message("Result", result=number)


class Simple:
    """An actionlib.SimpleActionServer whose goal runs until it is preempted or ``finish`` is called."""

    def __init__(self, name, type):
        self.type, self.done = type, threading.Event()
        self.server = actionlib.SimpleActionServer(name, action_class(type), self.execute, auto_start=False)
        self.server.start()

    def execute(self, goal):
        result = roslib.message.get_message_class(self.type + "Result")
        while not rospy.is_shutdown():
            if self.server.is_preempt_requested():
                self.server.set_preempted(result())
                return
            if self.done.wait(0.01):
                self.done.clear()
                self.server.set_succeeded(result(), "Goal reached.")
                return

    def finish(self, id, outcome):
        self.done.set()


class Client:
    """An actionlib.ActionClient that records the states of its goals."""

    def __init__(self, name, type):
        self.type, self.goals, self.ready = type, {}, threading.Condition()
        self.client = actionlib.ActionClient(name, action_class(type))

    def send(self, number, key):
        record: dict = {"feedback": [], "states": [], "done": 0, "handle": None}
        self.goals[key] = record

        def changed(handle) -> None:
            with self.ready:
                record["states"].append(CommState.to_string(handle.get_comm_state()))
                if handle.get_comm_state() == CommState.DONE:
                    record["done"] += 1
                self.ready.notify_all()

        def on_feedback(handle, feedback) -> None:
            with self.ready:
                record["feedback"].append(feedback.feedback)
                self.ready.notify_all()

        goal = roslib.message.get_message_class(self.type + "Goal")(goal=number)
        record["handle"] = self.client.send_goal(goal, changed, on_feedback)

    def outcome(self, key):
        record = self.goals[key]
        handle = record["handle"]
        result = handle.get_result()
        return {
            "id": handle.comm_state_machine.action_goal.goal_id.id,
            "state": handle.get_goal_status(), "text": handle.get_goal_status_text(), "done": record["done"],
            "result": None if result is None else result.result,
            "feedback": record["feedback"], "states": record["states"],
        }  # fmt: skip


class Flood:
    """Goals without an actionlib client, which is too slow for a thousand."""

    def __init__(self, name, type):
        self.ready = threading.Condition()
        self.goal = roslib.message.get_message_class(type + "ActionGoal")
        self.results = {}
        self.publisher = rospy.Publisher(name + "/goal", self.goal, queue_size=0)
        result = roslib.message.get_message_class(type + "ActionResult")
        rospy.Subscriber(name + "/result", result, self.on_result, buff_size=1 << 22)

    def on_result(self, message):
        with self.ready:
            results = self.results.setdefault(message.status.goal_id.id, [])
            results.append([message.status.status, message.result.result])
            self.ready.notify_all()

    def send(self, count):
        for number in range(count):
            message = self.goal()
            message.goal_id = GoalID(id=f"g{number}", stamp=rospy.Time(1 + number))
            message.goal.goal = number
            self.publisher.publish(message)


CONNECTOR = Connector()


class Peer(Commands):
    """Executes the commands."""

    def stall(self, id):
        """Let the callback of the next goal wait for ``resume``, after the goal has ended."""
        self.parts[id].free.clear()
        return {}

    def resume(self, id):
        self.parts[id].free.set()
        return {}

    def attempts(self, topic):
        """Return how often rospy has tried to connect to a publisher of a topic."""
        return {"count": CONNECTOR.attempts(topic)}

    def server(self, name, type="actionlib/Test", simple=False):
        return self.add((Simple if simple else Server)(name, type))

    def finish(self, id, goal="", outcome="succeed"):
        self.parts[id].finish(goal, outcome)
        return {}

    def finish_all(self, id):
        """End each goal that has not ended; its number // 100 modulo 3 selects succeed, abort or preempt."""
        server = self.parts[id]
        for goal_id, number in list(server.items):
            if server.handles[goal_id].get_goal_status().status not in ENDED:
                server.finish(goal_id, ("succeed", "abort", "preempt")[number // 100 % 3])
        return {}

    def stop_server(self, id):
        self.parts[id].server.stop()
        return {}

    def client(self, name, type="actionlib/Test"):
        return self.add(Client(name, type))

    def wait_for_server(self, id, seconds=40.0):
        return {"there": self.parts[id].client.wait_for_server(rospy.Duration(seconds))}

    def send(self, id, numbers):
        for number in numbers:
            self.parts[id].send(number, number)
        return {}

    def outcomes(self, id, numbers, seconds=40.0, state="DONE"):
        """Return the outcomes of goals, once all goals have reached a client state or the time is over."""
        client = self.parts[id]
        with client.ready:
            client.ready.wait_for(lambda: all(state in client.goals[n]["states"] for n in numbers), seconds)
        return {"outcomes": [client.outcome(n) for n in numbers]}

    def cancel(self, id, number=None, before=None):
        client = self.parts[id]
        if number is not None:
            client.goals[number]["handle"].cancel()
        elif before is not None:
            client.client.cancel_goals_at_and_before_time(rospy.Time(*before))
        else:
            client.client.cancel_all_goals()
        return {}

    def cancel_id(self, id, goal):
        self.parts[id].client.pub_cancel.publish(GoalID(id=goal))
        return {}

    def raw_goal(self, id, number, goal="", stamp=(0, 0)):
        """Send an ActionGoal with a given id and stamp."""
        client = self.parts[id]
        message = client.client.ActionGoal()
        message.goal_id = GoalID(id=goal, stamp=rospy.Time(*stamp))
        message.goal.goal = number
        client.client.pub_goal.publish(message)
        return {}

    def flood(self, name, count, type="actionlib/Test"):
        flood = Flood(name, type)
        # the bridge's probe may connect earlier
        until(lambda: flood.publisher.impl.has_connection("/midspan"), "the bridge is connected")
        flood.send(count)
        return self.add(flood)

    def results(self, id, count, seconds=60.0):
        flood = self.parts[id]
        with flood.ready:
            flood.ready.wait_for(lambda: len(flood.results) >= count, seconds)
            return {"results": {goal: list(results) for goal, results in flood.results.items()}}

    def status(self, id):
        status = self.parts[id].client.last_status_msg
        return {"goals": [[s.goal_id.id, s.status, s.text] for s in status.status_list] if status else None}


def main():
    answers = only_answers()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    rospy.init_node(sys.argv[1], disable_signals=True)
    serve(Peer(), answers)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # would end the clean-up, and leave registrations behind
    shut_down()


main()

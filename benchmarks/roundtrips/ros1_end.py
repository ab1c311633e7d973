"""A ROS 1 end: standard rospy and actionlib, with persistent connections to services."""

from __future__ import annotations

import os
import threading
import time
from typing import Any

import actionlib
import rospy
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from nav_msgs.srv import GetMap, GetMapResponse
from std_srvs.srv import SetBool, SetBoolResponse

from benchmarks.roundtrips.end import MAP_SIDE, End

SECONDS = 30.0


class Ros1End(End):
    """A program with one rospy node."""

    def __init__(self) -> None:
        rospy.init_node(f"end_{os.getpid()}", disable_signals=True, disable_rosout=True)
        self._services: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._servers: list[Any] = []

    def serve(self, prefix: str) -> None:
        grid = GetMapResponse()
        grid.map.info.width = grid.map.info.height = MAP_SIDE
        grid.map.data = bytes(MAP_SIDE * MAP_SIDE)
        self._servers = [
            rospy.Service(f"{prefix}/call", SetBool, lambda _request: SetBoolResponse(True, "done")),
            rospy.Service(f"{prefix}/map", GetMap, lambda _request: grid),
        ]
        for name, accept, cancel in (("go", _succeed, _nothing), ("hold", _accept, _cancel)):
            server = actionlib.ActionServer(f"{prefix}/{name}", MoveBaseAction, accept, cancel, auto_start=False)
            server.start()
            self._servers.append(server)

    def wait_for(self, prefix: str) -> None:
        for name, kind in (("call", SetBool), ("map", GetMap)):
            rospy.wait_for_service(f"{prefix}/{name}", SECONDS)
            self._services[f"{prefix}/{name}"] = rospy.ServiceProxy(f"{prefix}/{name}", kind, persistent=True)
        for name in ("go", "hold"):
            client = self._clients[f"{prefix}/{name}"] = actionlib.ActionClient(f"{prefix}/{name}", MoveBaseAction)
            if not client.wait_for_server(rospy.Duration(SECONDS)):
                raise RuntimeError("no server of " + prefix)

    def call(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        self._services[f"{prefix}/call"](True)
        return time.perf_counter_ns() - began

    def get_map(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        reply = self._services[f"{prefix}/map"]()
        duration = time.perf_counter_ns() - began
        if len(reply.map.data) != MAP_SIDE * MAP_SIDE:
            raise RuntimeError("the map is incomplete")
        return duration

    def run_goal(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        _Goal(self._clients[f"{prefix}/go"], began).wait(actionlib.CommState.DONE)
        return time.perf_counter_ns() - began

    def cancel_goal(self, prefix: str) -> int:
        goal = _Goal(self._clients[f"{prefix}/hold"], 0)
        goal.wait(actionlib.CommState.ACTIVE)
        time.sleep(0.02)
        began = time.perf_counter_ns()
        goal.handle.cancel()
        goal.wait(actionlib.CommState.DONE)
        return time.perf_counter_ns() - began

    def close(self) -> None:
        rospy.signal_shutdown("done")


class _Goal:
    def __init__(self, client: Any, number: int) -> None:
        self._changed = threading.Condition()
        self._state = -1
        goal = MoveBaseGoal()
        goal.target_pose.header.frame_id = "map"
        goal.target_pose.pose.orientation.w = 1.0
        goal.target_pose.pose.position.x = float(number % 1000)
        self.handle = client.send_goal(goal, self._on_transition)

    def _on_transition(self, handle: Any) -> None:
        with self._changed:
            self._state = handle.get_comm_state()
            self._changed.notify_all()

    def wait(self, state: int) -> None:
        """Wait until the goal is in a state."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._state == state, SECONDS):
                raise RuntimeError("the goal does not reach the state")


def _succeed(goal: Any) -> None:
    goal.set_accepted()
    goal.set_succeeded()


def _accept(goal: Any) -> None:
    goal.set_accepted()


def _cancel(goal: Any) -> None:
    goal.set_canceled()


def _nothing(_goal: Any) -> None:
    """Do nothing, because there is nothing to cancel."""


if __name__ == "__main__":
    Ros1End().run()

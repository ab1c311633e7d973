"""A ROS 2 end: standard rclpy, with a node and an executor for each client and server, which is fastest."""

from __future__ import annotations

import os
import threading
import time
from typing import Any

import rclpy
from nav2_msgs.action import NavigateToPose
from nav_msgs.srv import GetMap
from rclpy import action, task
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool
from typing_extensions import override

from benchmarks.roundtrips.end import MAP_SIDE, End

SECONDS = 30.0
_action: Any = action  # rclpy's types do not cover actions
_task: Any = task


class Ros2End(End):
    """A program with an rclpy node for each client and server."""

    def __init__(self) -> None:
        rclpy.init()
        self._executors: dict[str, SingleThreadedExecutor] = {}
        self._ends: dict[str, Any] = {}
        self._held: dict[bytes, Any] = {}

    def _node(self, name: str) -> Any:
        name_ = f"end_{os.getpid()}_{len(self._executors)}"
        node: Any = rclpy.create_node(name_, enable_rosout=False, start_parameter_services=False)
        executor = self._executors[name] = SingleThreadedExecutor()
        executor.add_node(node)
        return node

    @override
    def serve(self, prefix: str) -> None:
        grid = GetMap.Response()
        grid.map.info.width = grid.map.info.height = MAP_SIDE
        grid.map.data.frombytes(bytes(MAP_SIDE * MAP_SIDE))
        self._node("call").create_service(SetBool, f"{prefix}/call", _done)
        self._node("map").create_service(GetMap, f"{prefix}/map", lambda _request, _reply: grid)
        self._ends["go"] = _action.ActionServer(self._node("go"), NavigateToPose, f"{prefix}/go", _succeed)
        self._ends["hold"] = _action.ActionServer(
            self._node("hold"), NavigateToPose, f"{prefix}/hold", self._hold, cancel_callback=self._cancel
        )
        for executor in self._executors.values():
            threading.Thread(target=executor.spin, daemon=True).start()

    async def _hold(self, goal: Any) -> Any:
        await self._held.setdefault(bytes(goal.goal_id.uuid), _task.Future())
        goal.canceled()
        return NavigateToPose.Result()

    def _cancel(self, goal: Any) -> Any:
        self._held.setdefault(bytes(goal.goal_id.uuid), _task.Future()).set_result(None)
        self._executors["hold"].wake()  # setting a future's result does not wake the executor
        return _action.CancelResponse.ACCEPT

    @override
    def wait_for(self, prefix: str) -> None:
        for name, kind in (("call", SetBool), ("map", GetMap)):
            path = f"{prefix}/{name}"
            client = self._ends[path] = self._node(path).create_client(kind, path)
            if not client.wait_for_service(SECONDS):
                raise RuntimeError("no server of " + prefix)
        for name in ("go", "hold"):
            path = f"{prefix}/{name}"
            client = self._ends[path] = _action.ActionClient(self._node(path), NavigateToPose, path)
            if not client.wait_for_server(SECONDS):
                raise RuntimeError("no server of " + prefix)

    @override
    def call(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        path = f"{prefix}/call"
        self._until(path, self._ends[path].call_async(SetBool.Request(data=True)))
        return time.perf_counter_ns() - began

    @override
    def get_map(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        path = f"{prefix}/map"
        reply = self._until(path, self._ends[path].call_async(GetMap.Request()))
        duration = time.perf_counter_ns() - began
        if len(reply.map.data) != MAP_SIDE * MAP_SIDE:
            raise RuntimeError("the map is incomplete")
        return duration

    @override
    def run_goal(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        path = f"{prefix}/go"
        goal = self._until(path, self._ends[path].send_goal_async(_goal()))
        self._until(path, goal.get_result_async())
        return time.perf_counter_ns() - began

    @override
    def cancel_goal(self, prefix: str) -> int:
        path = f"{prefix}/hold"
        goal = self._until(path, self._ends[path].send_goal_async(_goal()))
        ended = goal.get_result_async()
        self._executors[path].spin_once(0.02)
        time.sleep(0.02)
        began = time.perf_counter_ns()
        goal.cancel_goal_async()
        self._until(path, ended)
        return time.perf_counter_ns() - began

    @override
    def close(self) -> None:
        """Exit at once, without closing the middleware."""
        os._exit(0)

    def _until(self, path: str, future: Any) -> Any:
        self._executors[path].spin_until_future_complete(future, SECONDS)
        if not future.done():
            raise RuntimeError("no answer")
        return future.result()


def _done(_request: Any, reply: Any) -> Any:
    reply.success, reply.message = True, "done"
    return reply


def _succeed(goal: Any) -> Any:
    goal.succeed()
    return NavigateToPose.Result()


def _goal() -> Any:
    goal = NavigateToPose.Goal()
    goal.pose.header.frame_id = "map"
    goal.pose.pose.orientation.w = 1.0
    return goal


if __name__ == "__main__":
    Ros2End().run()

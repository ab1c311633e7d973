"""A node that serves ``NavigateToPose`` on the hub as an rmw_zenoh node does, without Midspan's endpoints."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from threading import Lock
from typing import Any

import zenoh

from bridge.hub.graph.tokens import EndpointKind, EndpointToken, NodeToken, endpoint_key, gid_of, node_key
from bridge.hub.wire.keys import pack_attachment, topic_key, unpack_attachment
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.actions import CANCEL, STATUSES, GoalState, names, types
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from tests.peers.zenoh.rmw import RmwPublisher, rmw_session

NAVIGATE = "nav2_msgs/action/NavigateToPose"
REGISTRY = Registry()
Handler = Callable[[zenoh.Query, dict[str, Any]], None]


class RmwActionServer:
    """The node with its five endpoints, each with a liveliness token and a queryable or publisher.

    Accepted goals run until the test ends them. The endpoints can be closed one by one, and declared again, while goals
    are executed; this is what the gateway observes if the worker of a planner's side is killed.

    Attributes:
        goals: ids of the accepted goals, oldest first.
        canceled: ids of goals that clients requested to cancel; zeros stand for all goals.
        rejects: whether the server rejects goals.
        cancels: whether the server ends goals that a client requests to cancel.
        lists: whether the goal list is published when the server is declared, as Midspan's servers do and rcl's do not.
        loses: number of following requests for a result whose reply is lost, as by a server that has just started.
    """

    def __init__(
        self, router: str, domain: int, node: str, action: str, *, cancels: bool = True, lists: bool = False
    ) -> None:
        self._session = rmw_session(router)
        self._domain, self._action = domain, action
        self.cancels, self.lists, self.rejects, self.loses = cancels, lists, False, 0
        self._lost: list[zenoh.Query] = []
        self._lock, self._listing = Lock(), Lock()
        self._ids = itertools.count(1)
        self._owner = NodeToken(domain, str(self._session.zid()), "0", "/", node)
        self._tokens = [self._declare(node_key(self._owner))]
        self._parts: dict[str, list[Any]] = {}
        self._waiting: dict[bytes, zenoh.Query] = {}
        self._statuses: dict[bytes, GoalState] = {}
        self.goals: list[bytes] = []
        self.canceled: list[bytes] = []
        self.serve()

    def serve(self, *, feedback: bool = True) -> None:
        """Declare all endpoints, optionally without feedback."""
        parts, kinds = names(self._action), types(NAVIGATE)
        self._kinds = {parts.send_goal: kinds.send_goal, parts.get_result: kinds.get_result, parts.cancel_goal: CANCEL}
        self._serve("send_goal", parts.send_goal, self._accept)
        self._serve("get_result", parts.get_result, self._result)
        self._serve("cancel_goal", parts.cancel_goal, self._cancel)
        if feedback:
            self._publish("feedback", parts.feedback, kinds.feedback, Qos(depth=10))
        self._status = self._publish("status", parts.status, STATUSES, LATCHED)
        if self.lists:
            self.tell()

    def withdraw(self) -> None:
        """Close all endpoints; pending calls fail, and goals continue."""
        for part in list(self._parts):
            self.close_part(part)

    def close_part(self, part: str) -> None:
        """Close one of ``send_goal``, ``get_result``, ``cancel_goal``, ``feedback`` and ``status``."""
        if part == "get_result":
            with self._lock:
                waiting, self._waiting = self._waiting, {}
            for query in waiting.values():
                query.drop()
        for declared in self._parts.pop(part):
            declared.close() if isinstance(declared, RmwPublisher) else declared.undeclare()

    def end(self, status: GoalState, code: int = 0, why: str = "") -> None:
        """End the last goal: publish the list, then reply with the result."""
        self._statuses[self.goals[-1]] = status
        self.tell()
        self.answer(status, code, why)

    def answer(self, status: GoalState, code: int = 0, why: str = "") -> None:
        """Reply with the last goal's result, without publishing the list; `GoalState.UNKNOWN` for a lost goal."""
        goal = self.goals[-1]
        with self._lock:
            if status.ended:
                self._statuses[goal] = status
            query = self._waiting.pop(goal, None)
        if query is not None:
            self._answer_result(query, status, code, why)

    def set(self, goal: bytes, status: GoalState = GoalState.EXECUTING) -> None:
        """Set the state of any client's goal, without publishing the list."""
        self._statuses[goal] = status

    def forget(self) -> None:
        """Drop all goals, as a restart does."""
        self._statuses.clear()

    def waits(self, goal: bytes) -> bool:
        """Return whether a client waits for the result of a goal."""
        return goal in self._waiting

    def executes(self, goal: bytes) -> bool:
        """Return whether a goal is still active."""
        return not self._statuses[goal].ended

    def announce_subscription(self, topic: str, kind: str) -> None:
        """Announce a subscription of the node; it receives nothing."""
        number, type_hash = str(next(self._ids)), REGISTRY.ros2(kind).type_id
        token = EndpointToken(self._owner, number, EndpointKind.SUBSCRIPTION, topic, kind, type_hash, Qos(depth=1))
        self._tokens.append(self._declare(endpoint_key(token)))

    def close(self) -> None:
        """Leave the hub."""
        self._session.close()

    # -- endpoints -----------------------------------------------------------------------------------------------------

    def _declare(self, key: str) -> zenoh.LivelinessToken:
        return self._session.liveliness().declare_token(key)

    def _serve(self, part: str, name: str, handler: Handler) -> None:
        kind = self._kinds[name]
        type_hash = REGISTRY.service_ros2(kind).type_id

        def receive(query: zenoh.Query) -> None:
            assert query.payload is not None
            handler(query, MessageReader(REGISTRY.service_schemas(kind)[0], query.payload.to_bytes()).message())

        key = topic_key(self._domain, name, kind, type_hash)
        queryable = self._session.declare_queryable(
            key, zenoh.handlers.Callback(receive, indirect=False), complete=True
        )
        number = str(next(self._ids))
        token = EndpointToken(self._owner, number, EndpointKind.SERVER, name, kind, type_hash, Qos())
        self._parts[part] = [self._declare(endpoint_key(token)), queryable]

    def _publish(self, part: str, topic: str, kind: str, qos: Qos) -> RmwPublisher:
        type_hash = REGISTRY.ros2(kind).type_id
        number = str(next(self._ids))
        token = endpoint_key(EndpointToken(self._owner, number, EndpointKind.PUBLISHER, topic, kind, type_hash, qos))
        publisher = RmwPublisher(self._session, topic_key(self._domain, topic, kind, type_hash), qos, gid_of(token))
        publisher.announce(token)
        self._parts[part] = [publisher]
        return publisher

    def _reply(self, query: zenoh.Query, kind: str, reply: dict[str, Any]) -> None:
        assert query.attachment is not None
        number, _time, client = unpack_attachment(query.attachment.to_bytes())
        payload = MessageWriter(REGISTRY.service_schemas(kind)[1]).message(reply)
        query.reply(query.key_expr, payload, attachment=pack_attachment(number, time.time_ns(), client))
        query.drop()

    # -- the action ----------------------------------------------------------------------------------------------------

    def _accept(self, query: zenoh.Query, request: dict[str, Any]) -> None:
        goal = bytes(request["goal_id"]["uuid"])
        if not self.rejects:
            self._statuses[goal] = GoalState.EXECUTING
            self.goals.append(goal)
        self._reply(query, f"{NAVIGATE}_SendGoal", {"accepted": not self.rejects})
        self.tell()

    def _result(self, query: zenoh.Query, request: dict[str, Any]) -> None:
        goal = bytes(request["goal_id"]["uuid"])
        with self._lock:  # the goal may be ending on the test's thread
            status = self._statuses.get(goal, GoalState.UNKNOWN)
            if self.loses:
                self.loses -= 1
                self._lost.append(query)
                return
            if status is not GoalState.UNKNOWN and not status.ended:
                self._waiting[goal] = query
                return
        self._answer_result(query, status, 0, "")

    def _answer_result(self, query: zenoh.Query, status: GoalState, code: int, why: str) -> None:
        result = {"error_code": code, "error_msg": why}
        self._reply(query, f"{NAVIGATE}_GetResult", {"status": int(status), "result": result})

    def _cancel(self, query: zenoh.Query, request: dict[str, Any]) -> None:
        wanted = bytes(request["goal_info"]["goal_id"]["uuid"])
        self.canceled.append(wanted)
        self._reply(query, CANCEL, {"return_code": 0})
        if self.cancels:
            self.cancel(wanted)

    def cancel(self, wanted: bytes = bytes(16)) -> None:
        """End a goal as canceled; zeros stand for all goals."""
        for goal in [goal for goal, status in self._statuses.copy().items() if not status.ended]:
            if goal == wanted or not any(wanted):
                with self._lock:
                    self._statuses[goal] = GoalState.CANCELED
                    waiting = self._waiting.pop(goal, None)
                self.tell()
                if waiting is not None:
                    self._answer_result(waiting, GoalState.CANCELED, 0, "")

    def tell(self) -> None:
        """Publish the goal list; on the test's thread, or on zenoh's for a request."""
        with self._listing:  # lists are published in order, each with its own number
            entries = [
                {"goal_info": {"goal_id": {"uuid": list(goal)}}, "status": int(status)}
                for goal, status in self._statuses.copy().items()
            ]
            if "status" in self._parts:
                self._status.put(MessageWriter(REGISTRY.schema(STATUSES)).message({"status_list": entries}))

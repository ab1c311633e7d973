"""A node that serves ``NavigateToPose`` on the hub as rmw_zenoh's nodes do, without Midspan's endpoints."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import zenoh

from bridge.hub.graph.tokens import EndpointKind, EndpointToken, NodeToken, endpoint_key, node_key
from bridge.hub.wire.keys import pack_attachment, topic_key, unpack_attachment
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.actions import CANCEL, STATUSES, GoalState, names, types
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from tests.support.zenoh_rmw import RmwPublisher, rmw_session

NAVIGATE = "nav2_msgs/action/NavigateToPose"
REGISTRY = Registry()
Handler = Callable[[zenoh.Query, dict[str, Any]], None]


class RmwActionServer:
    """The node with its five endpoints, each with a liveliness token and a queryable or publisher.

    It accepts each goal; `end` ends the last one. `close_part` closes one of the five endpoints by its short name.

    Attributes:
        goals: the ids of goals that were accepted, the oldest first.
        canceled: the ids of goals that a client asked to cancel; zeros for all.
    """

    def __init__(self, router: str, domain: int, node: str, action: str, *, cancels: bool = True) -> None:
        self._session = rmw_session(router)
        self._domain, self._cancels = domain, cancels
        self._owner = NodeToken(domain, str(self._session.zid()), "0", "/", node)
        self._tokens = [self._declare(node_key(self._owner))]
        self._parts: dict[str, list[Any]] = {}
        self._waiting: dict[bytes, zenoh.Query] = {}
        self._statuses: dict[bytes, GoalState] = {}
        self.goals: list[bytes] = []
        self.canceled: list[bytes] = []
        parts, kinds = names(action), types(NAVIGATE)
        self._kinds = {parts.send_goal: kinds.send_goal, parts.get_result: kinds.get_result, parts.cancel_goal: CANCEL}
        self._serve("send_goal", parts.send_goal, self._accept)
        self._serve("get_result", parts.get_result, self._result)
        self._serve("cancel_goal", parts.cancel_goal, self._cancel)
        self._publish("feedback", parts.feedback, kinds.feedback, Qos(depth=10))
        self._status = self._publish("status", parts.status, STATUSES, LATCHED)

    def close_part(self, part: str) -> None:
        """Close one of ``send_goal``, ``get_result``, ``cancel_goal``, ``feedback`` and ``status``."""
        for declared in self._parts.pop(part):
            declared.close() if isinstance(declared, RmwPublisher) else declared.undeclare()

    def end(self, status: GoalState, code: int = 0, why: str = "") -> None:
        """End the last goal."""
        goal = self.goals[-1]
        self._statuses[goal] = status
        self._tell()
        query = self._waiting.pop(goal, None)
        if query is not None:
            self._answer_result(query, status, code, why)

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
        token = EndpointToken(self._owner, str(len(self._parts) + 1), EndpointKind.SERVER, name, kind, type_hash, Qos())
        self._parts[part] = [self._declare(endpoint_key(token)), queryable]

    def _publish(self, part: str, topic: str, kind: str, qos: Qos) -> RmwPublisher:
        type_hash = REGISTRY.ros2(kind).type_id
        publisher = RmwPublisher(self._session, topic_key(self._domain, topic, kind, type_hash), qos)
        number = str(len(self._parts) + 1)
        token = EndpointToken(self._owner, number, EndpointKind.PUBLISHER, topic, kind, type_hash, qos)
        publisher.announce(endpoint_key(token))
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
        self._statuses[goal] = GoalState.EXECUTING
        self.goals.append(goal)
        self._reply(query, f"{NAVIGATE}_SendGoal", {"accepted": True})
        self._tell()

    def _result(self, query: zenoh.Query, request: dict[str, Any]) -> None:
        goal = bytes(request["goal_id"]["uuid"])
        status = self._statuses.get(goal, GoalState.UNKNOWN)
        if status is GoalState.EXECUTING:
            self._waiting[goal] = query
        else:
            self._answer_result(query, status, 0, "")

    def _answer_result(self, query: zenoh.Query, status: GoalState, code: int, why: str) -> None:
        result = {"error_code": code, "error_msg": why}
        self._reply(query, f"{NAVIGATE}_GetResult", {"status": int(status), "result": result})

    def _cancel(self, query: zenoh.Query, request: dict[str, Any]) -> None:
        self.canceled.append(bytes(request["goal_info"]["goal_id"]["uuid"]))
        self._reply(query, CANCEL, {"return_code": 0})
        if self._cancels and self.goals:
            self.end(GoalState.CANCELED)

    def _tell(self) -> None:
        entries = [
            {"goal_info": {"goal_id": {"uuid": list(goal)}}, "status": int(status)}
            for goal, status in self._statuses.items()
        ]
        if "status" in self._parts:
            self._status.put(MessageWriter(REGISTRY.schema(STATUSES)).message({"status_list": entries}))

"""ROS 1 nodes for small programs, on any computer with Python: topics and actions, without ROS 1's packages.

On the graph, such a node looks like any other ROS 1 node. Messages are JSON values (`bridge.messages.json`) with
ROS 1's field names; times are ``{"sec": ..., "nanosec": ...}``, and headers have no ``seq``.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, NamedTuple, Self
from urllib.parse import urlsplit

from bridge.adapters.ros1.actions import discovery, wire
from bridge.adapters.ros1.actions.client import ActionlibClient
from bridge.adapters.ros1.actions.frames import empty
from bridge.adapters.ros1.actions.network import types_of
from bridge.adapters.ros1.actions.states import text_of
from bridge.adapters.ros1.actions.wire import ZERO, GoalId
from bridge.adapters.ros1.environment import DEFAULT_MASTER, is_local
from bridge.adapters.ros1.node.address import NodeAddress
from bridge.adapters.ros1.node.plain import Deliver, PlainNode, PlainNodeEvents
from bridge.adapters.ros1.topics.publication import Publication
from bridge.adapters.ros1_peers import Ros1Error, XmlRpcClient
from bridge.concurrency import InlineExecutor
from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import GoalState
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import SideType

_MASTER_SECONDS = 5.0
_TICK_SECONDS = 0.1
_DEPTH = 100

Message = Mapping[str, Any]


class Ros1Program:
    """A node whose name is ``name`` and a random suffix; ``master`` defaults to ``ROS_MASTER_URI``.

    Its methods raise `bridge.adapters.ros1_peers.Ros1Error` if the master does not respond, and
    `bridge.messages.errors.MessageTypeError` for unknown types.
    """

    def __init__(self, name: str, registry: Registry | None = None, *, master: str = "") -> None:
        self.registry = registry or Registry()
        self.changed = threading.Condition()
        self._uri = master or os.environ.get("ROS_MASTER_URI") or DEFAULT_MASTER
        environ = dict(os.environ)
        if not {"ROS_IP", "ROS_HOSTNAME"} & environ.keys() and is_local(urlsplit(self._uri).hostname or ""):
            environ["ROS_IP"] = "127.0.0.1"
        self.name = f"/{name.strip('/')}_{uuid.uuid4().hex[:12]}"
        self._registering = threading.Lock()
        self._closed = False
        self._registered: set[tuple[str, str]] = set()
        self._types: dict[str, str] = {}
        events = PlainNodeEvents(self._publishers, self._notify, lambda _reason: self._notify())
        self._node = PlainNode(self.name, self._uri, NodeAddress.of(environ), events)

    def publish(self, topic: str, side_type: SideType, *, latched: bool = False) -> Publication:
        """Open a publication of serialized messages."""
        publication = self._node.publish(topic, side_type, latched=latched)
        self._call("registerPublisher", topic, side_type.name)
        self._registered.add(("unregisterPublisher", topic))
        return publication

    def unpublish(self, publication: Publication, *, latched: bool = False) -> None:
        """End a publication; ``latched`` must be the same as in the call of `publish`."""
        self._node.unpublish(publication, latched=latched)
        self._unregister("unregisterPublisher", publication.topic)

    def subscribe(self, topic: str, side_type: SideType, deliver: Deliver) -> None:
        """Subscribe to a topic's serialized messages; ``deliver`` is called on any thread."""
        self._node.subscribe(topic, side_type, deliver)
        self._types[topic] = side_type.name
        self._registered.add(("unregisterSubscriber", topic))
        try:
            self._publishers(topic)
        except Ros1Error:
            self._registered.discard(("unregisterSubscriber", topic))
            self._node.unsubscribe(topic)
            raise
        self._node.follow()

    def unsubscribe(self, topic: str) -> None:
        """End a subscription."""
        self._node.unsubscribe(topic)
        self._unregister("unregisterSubscriber", topic)

    def publishers(self, topic: str) -> set[str]:
        """Return the nodes that publish a subscribed topic and to which this node is connected."""
        return self._node.publishers(topic)

    def wait_for_message(self, topic: str, type_name: str, seconds: float) -> Message | None:
        """Return a topic's next or latched message; None if none arrives within ``seconds``."""
        received: list[bytes] = []

        def deliver(payload: bytes, _uri: str) -> None:
            received.append(payload)
            self._notify()

        self.subscribe(topic, self.registry.ros1(type_name), deliver)
        self.wait(lambda: bool(received), seconds)
        self.unsubscribe(topic)
        return self.decode(type_name, received[0]) if received else None

    def action_client(self, name: str, type_name: str) -> Ros1ActionClient:
        """Return a client of an action, such as ``/move_base`` of type ``move_base_msgs/MoveBase``."""
        return Ros1ActionClient(self, name, type_name)

    def encode(self, type_name: str, message: Message) -> bytes:
        """Serialize a message; missing fields have their defaults. Raises `bridge.messages.errors.ConversionError`."""
        name = self.registry.ros1_to_hub(type_name).target.name
        convert = self.registry.hub_to_ros1(name).convert
        cdr = from_json(self.registry, name, message)
        return cdr if convert is None else convert(cdr)

    def decode(self, type_name: str, payload: bytes) -> Message:
        """Parse a message; raises `bridge.messages.errors.ConversionError`."""
        conversion = self.registry.ros1_to_hub(type_name)
        cdr = payload if conversion.convert is None else conversion.convert(payload)
        return to_json(self.registry, conversion.target.name, cdr)

    def wait(self, ready: Callable[[], bool], seconds: float) -> bool:
        """Wait until ``ready()`` is true, and return whether it is.

        ``ready`` is called when connections change, and after each message of `wait_for_message` and action clients.
        """
        with self.changed:
            return self.changed.wait_for(ready, seconds)

    def close(self) -> None:
        """Unregister from the master and close all connections; errors of an unreachable master are ignored."""
        with self._registering:
            self._closed, registered = True, self._registered
            with contextlib.suppress(Ros1Error):
                for method, topic in registered:
                    self._call(method, topic)
        self._node.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def _publishers(self, topic: str) -> list[str]:
        """Return a topic's publishers from the master; the query registers the subscription (again)."""
        with self._registering:
            if self._closed or ("unregisterSubscriber", topic) not in self._registered:
                return []
            return list(map(str, self._call("registerSubscriber", topic, self._types[topic])))

    def _unregister(self, method: str, topic: str) -> None:
        with self._registering:
            self._registered.discard((method, topic))
            self._call(method, topic)

    def _call(self, method: str, *params: str) -> Any:
        client = XmlRpcClient(self._uri, _MASTER_SECONDS)
        try:
            return client.call(method, self.name, *params, self._node.uri)
        finally:
            client.close()

    def _notify(self) -> None:
        with self.changed:
            self.changed.notify_all()


class GoalOutcome(NamedTuple):
    """The end of a goal: its state, the server's text unless the goal succeeded, and the result's fields."""

    state: GoalState
    text: str
    result: Message

    @property
    def succeeded(self) -> bool:
        """Whether the server reports success."""
        return self.state is GoalState.SUCCEEDED


class Ros1ActionClient:
    """A client of one actionlib action; created by `Ros1Program.action_client`."""

    def __init__(self, program: Ros1Program, name: str, type_name: str) -> None:
        self._program, self._type = program, type_name
        self._executor = InlineExecutor()
        types = types_of(program.registry, type_name)
        self._client = ActionlibClient(name, self, time.monotonic, empty(types.result_body))
        self._feedback: tuple[bytes, Callable[[Message], None]] | None = None
        self._numbers = itertools.count()
        self._server = ""
        self._to_server = {
            part: program.publish(f"{name}/{part}", side_type)
            for part, side_type in ((discovery.GOAL, types.goal), (discovery.CANCEL, types.cancel))
        }
        reads: dict[str, tuple[SideType, Callable[[bytes], None]]] = {
            discovery.STATUS: (types.status, lambda data: self._client.statuses(wire.read_statuses(data))),
            discovery.FEEDBACK: (types.feedback, lambda data: self._client.feedback(*wire.read_action_outcome(data))),
            discovery.RESULT: (types.result, lambda data: self._client.result(*wire.read_action_outcome(data))),
        }
        self._from_server = [f"{name}/{part}" for part in reads]
        for part, (side_type, read) in reads.items():
            program.subscribe(f"{name}/{part}", side_type, self._reader(read))

    def wait_for_server(self, seconds: float) -> bool:
        """Wait until all five topics are connected to a server; return whether they are."""
        return self._program.wait(self._connected, seconds)

    def send_goal(self, goal: Message, on_feedback: Callable[[Message], None] | None = None) -> GoalOutcome:
        """Send a goal and wait for its end; ``on_feedback`` receives all feedback. An interrupt cancels the goal."""
        replies: list[bytes | CallError] = []
        goal_id = uuid.uuid4().bytes
        request = goal_id + self._program.encode(f"{self._type}Goal", goal)
        self._feedback = (goal_id, on_feedback) if on_feedback is not None else None
        try:
            self._executor.submit(lambda: self._client.send_goal(request, replies.append))
            first = self._wait_for(replies, 1)
            if isinstance(first, CallError):
                return self._outcome(first)
            if not wire.read_goal_response(first):
                return GoalOutcome(GoalState.UNKNOWN, "the server rejected the goal", {})
            self._executor.submit(lambda: self._client.get_result(goal_id, replies.append))
            last = self._wait_for(replies, 2)
        except BaseException:
            # not through the executor, which may be busy: the program may close before the executor runs the next job
            self.publish(discovery.CANCEL, wire.goal_id(GoalId(ZERO, text_of(goal_id))))
            self._executor.submit(lambda: self._client.close("interrupted"))
            raise
        return self._outcome(last)

    # -- called by the client ------------------------------------------------------------------------------------------

    def publish(self, part: str, payload: bytes) -> None:
        """Publish on the server's ``goal`` or ``cancel`` topic."""
        self._to_server[part].send(payload, str(next(self._numbers)), _DEPTH, retain=False)

    def deliver(self, part: str, payload: bytes) -> None:
        """Pass the goal's feedback to ``on_feedback``; the states are not used."""
        if part == discovery.FEEDBACK and self._feedback is not None:
            goal_id, body = wire.read_with_uuid(payload)
            if goal_id == self._feedback[0]:
                self._feedback[1](self._program.decode(f"{self._type}Feedback", body))

    # ------------------------------------------------------------------------------------------------------------------

    def _reader(self, read: Callable[[bytes], None]) -> Deliver:
        def deliver(payload: bytes, _uri: str) -> None:
            self._executor.submit(lambda: read(payload))
            with self._program.changed:
                self._program.changed.notify_all()

        return deliver

    def _connected(self) -> bool:
        """Return whether one node is connected to all five topics; inform the client if that has changed."""
        nodes = [self._program.publishers(topic) for topic in self._from_server]
        nodes += [{connection.peer for connection in p.connections} for p in self._to_server.values()]
        servers = sorted(set.intersection(*nodes))
        if self._server and self._server not in servers:
            reason, self._server = f"its action server {self._server} left", ""
            self._executor.submit(lambda: self._client.lost(reason))
        if servers and not self._server:
            self._server = servers[0]
            self._executor.submit(self._client.discovered)
            self._executor.submit(self._client.connected)
        return bool(self._server)

    def _wait_for(self, replies: list[bytes | CallError], count: int) -> bytes | CallError:
        while not self._program.wait(lambda: len(replies) >= count, _TICK_SECONDS):
            self._connected()
            self._executor.submit(self._client.tick)
        return replies[count - 1]

    def _outcome(self, reply: bytes | CallError) -> GoalOutcome:
        if isinstance(reply, CallError):
            return GoalOutcome(GoalState.UNKNOWN, str(reply), {})
        state, body, text = wire.read_result_response(reply)
        return GoalOutcome(GoalState(state), text, self._program.decode(f"{self._type}Result", body))

"""Actions of the nodes in `tests.peers.zenoh.releases`, with each release's versions of the types."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.actions import CANCEL, STATUSES, names, types
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from tests.peers.zenoh.releases import (
    ReleaseClient,
    ReleaseNode,
    ReleasePublisher,
    ReleaseServer,
    ReleaseSubscription,
    Topic,
)

REGISTRY = Registry()
SUCCEEDED = 4
_OLDER = {"lyrical": ("lyrical", "kilted", "jazzy"), "kilted": ("kilted", "jazzy")}


def hash_in(release: str, type_name: str) -> str:
    """Return the hash of a type in a release."""
    releases = REGISTRY.releases
    by_release = {releases.release(type_name, known): known for known in releases.hashes(type_name)}
    found = (by_release[name] for name in _OLDER.get(release, ("jazzy",)) if name in by_release)
    return next(found, next(iter(by_release.values())))


class ReleaseTypes:
    """The types of a node's release. Humble's messages use Humble's versions of the types."""

    def __init__(self, node: ReleaseNode) -> None:
        self.node = node

    def topic(self, name: str, type_name: str, qos: Qos | None = None) -> Topic:
        """Return a topic or service with the release's hash."""
        return Topic(name, type_name, hash_in(self.node.release.name, type_name), qos or Qos(depth=100))

    def _schema(self, type_name: str, part: str) -> Any:
        if not self.node.release.hashes:
            schema = REGISTRY.releases._versions.hashless(type_name) or REGISTRY.schema(type_name)
        else:
            schema = REGISTRY.schema(type_name, hash_in(self.node.release.name, type_name))
        return schema.sub(f"{type_name}_{part}") if part else schema

    def encode(self, type_name: str, value: Mapping[str, Any], part: str = "") -> bytes:
        """Return a message, or a request or response, as CDR."""
        return MessageWriter(self._schema(type_name, part)).message(value)

    def decode(self, type_name: str, cdr: bytes, part: str = "") -> dict[str, Any]:
        """Return the fields of a message, or of a request or response."""
        return MessageReader(self._schema(type_name, part), cdr).message()


class ReleaseActionServer:
    """An action server that accepts each goal, and replies to each request for a result that the goal succeeded.

    It publishes feedback of the last goal until it is closed.

    Attributes:
        goals: the goals received so far.
        canceled: the number of cancel requests.
    """

    def __init__(
        self, node: ReleaseNode, name: str, type_name: str, feedback: Mapping[str, Any], result: Mapping[str, Any]
    ) -> None:
        self.types, self._kinds = ReleaseTypes(node), types(type_name)
        self.goals: list[dict[str, Any]] = []
        self.canceled = 0
        self._feedback, self._result, self._parts = feedback, result, names(name)
        topic, kinds, parts = self.types.topic, self._kinds, self._parts
        self._ends: list[Any] = [
            ReleaseServer(node, topic(parts.send_goal, kinds.send_goal), self._accept),
            ReleaseServer(node, topic(parts.get_result, kinds.get_result), self._end),
            ReleaseServer(node, topic(parts.cancel_goal, CANCEL), self._cancel),
        ]
        self._publisher = ReleasePublisher(node, topic(parts.feedback, kinds.feedback))
        self._status = ReleasePublisher(node, topic(parts.status, STATUSES, LATCHED))
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._publish, daemon=True)
        self._thread.start()

    def _accept(self, request: bytes) -> bytes:
        self.goals.append(self.types.decode(self._kinds.send_goal, request, "Request"))
        return self.types.encode(self._kinds.send_goal, {"accepted": True}, "Response")

    def _end(self, _request: bytes) -> bytes:
        return self.types.encode(self._kinds.get_result, {"status": SUCCEEDED, "result": self._result}, "Response")

    def _cancel(self, _request: bytes) -> bytes:
        self.canceled += 1
        return self.types.encode(CANCEL, {}, "Response")

    def _publish(self) -> None:
        while not self._closed.wait(0.05):
            for goal in self.goals[-1:]:
                message = {"goal_id": goal["goal_id"], "feedback": self._feedback}
                self._publisher.put(self.types.encode(self._kinds.feedback, message))

    def close(self) -> None:
        """Withdraw the server's endpoints."""
        self._closed.set()
        self._thread.join()
        for end in (*self._ends, self._publisher, self._status):
            end.close()


class ReleaseActionClient:
    """A client of an action."""

    def __init__(self, node: ReleaseNode, name: str, type_name: str) -> None:
        self.types, self._kinds = ReleaseTypes(node), types(type_name)
        topic, kinds, parts = self.types.topic, self._kinds, names(name)
        self._send = ReleaseClient(node, topic(parts.send_goal, kinds.send_goal))
        self._result = ReleaseClient(node, topic(parts.get_result, kinds.get_result))
        self._feedback = ReleaseSubscription(node, topic(parts.feedback, kinds.feedback))

    def send(self, goal_id: bytes, goal: Mapping[str, Any]) -> dict[str, Any]:
        """Send a goal, and return the response."""
        request = {"goal_id": {"uuid": list(goal_id)}, "goal": goal}
        (reply,) = self._send.call(self.types.encode(self._kinds.send_goal, request, "Request"))
        return self.types.decode(self._kinds.send_goal, reply, "Response")

    def result(self, goal_id: bytes) -> dict[str, Any]:
        """Return the response that contains the result, once the goal has ended."""
        request = {"goal_id": {"uuid": list(goal_id)}}
        (reply,) = self._result.call(self.types.encode(self._kinds.get_result, request, "Request"))
        return self.types.decode(self._kinds.get_result, reply, "Response")

    def feedback(self) -> list[dict[str, Any]]:
        """Return the feedback so far."""
        samples = self._feedback.samples
        return [self.types.decode(self._kinds.feedback, sample.payload)["feedback"] for sample in samples]

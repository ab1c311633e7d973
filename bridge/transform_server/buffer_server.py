"""Performs lookups for programs without a buffer: the action ``/tf2_buffer_server`` and the service ``/tf2_frames``.

They match BufferServer and Buffer of tf2_ros, so that tf2_ros's BufferClient works with them, in ROS 1 and ROS 2. As in
tf2_ros, the goal of a failed lookup succeeds, with the error in the result.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from bridge.modules.action_server import Goal
from bridge.modules.host import ModuleNode
from bridge.modules.loop import Timer
from bridge.modules.services import Answer
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import ConnectivityError, ExtrapolationError, InvalidArgumentError, LookupError_, TransformError
from bridge.tf.transform import Transform

ACTION, LOOKUP = "/tf2_buffer_server", "tf2_msgs/action/LookupTransform"
FRAMES, FRAME_GRAPH = "/tf2_frames", "tf2_msgs/srv/FrameGraph"

RESULT_SECONDS = 10.0
"""Seconds for which a result is stored: clients fetch it at once, and there may be a hundred goals per second."""

_POLL_SECONDS = 0.005
_SECOND = 1_000_000_000
_ERRORS: dict[type[TransformError], int] = {
    LookupError_: 1,
    ConnectivityError: 2,
    ExtrapolationError: 3,
    InvalidArgumentError: 4,
}
_TRANSFORM_ERROR = 6  # as above, a code of tf2_msgs/msg/TF2Error


class BufferServer:
    """Performs lookups for clients, on the module's thread. The endpoints are closed with the node."""

    def __init__(self, node: ModuleNode, buffer: TransformBuffer) -> None:
        self._node, self._buffer = node, buffer
        self._waiting: dict[bytes, _Lookup] = {}
        self._timer: Timer | None = None
        self._seen = -1
        self._ended: Counter[str] = Counter()
        node.action_server(ACTION, LOOKUP, self._on_goal, self._cancel, result_seconds=RESULT_SECONDS)
        node.server(FRAMES, FRAME_GRAPH, self._reply_frames)

    def status(self) -> dict[str, int]:
        """Return the counts for the module's status document."""
        return {"waiting": len(self._waiting), **self._ended}

    def _on_goal(self, goal: Goal) -> bool:
        lookup = _Lookup(goal, self._node.clock.elapsed_ns())
        goal.execute()
        if not self._end(lookup):
            self._waiting[goal.id] = lookup
            if self._timer is None:
                self._timer = self._node.loop.every(_POLL_SECONDS, self._retry)
        return True

    def _cancel(self, goal: Goal) -> bool:
        if self._waiting.pop(goal.id, None) is not None:
            self._ended["canceled"] += 1
            goal.canceled()
        return True

    def _retry(self) -> None:
        """Retry the waiting lookups if a transform has arrived; end those whose time limit has passed."""
        changes, now = self._buffer.changes, self._node.clock.elapsed_ns()
        new, self._seen = changes != self._seen, changes
        for lookup in list(self._waiting.values()):
            if new or lookup.expired(now):
                self._end(lookup)
        if not self._waiting and self._timer is not None:
            self._timer.close()
            self._timer = None

    def _end(self, lookup: _Lookup) -> bool:
        """Send the result, or the error if waiting is useless; return whether the lookup has ended."""
        try:
            transform = lookup.run(self._buffer)
        except TransformError as err:
            final = isinstance(err, InvalidArgumentError) or lookup.expired(self._node.clock.elapsed_ns())
            if final:
                code = _ERRORS.get(type(err), _TRANSFORM_ERROR)
                self._finish(lookup, "failed", {"error": {"error": code, "error_string": str(err)}})
            return final
        self._finish(lookup, "found", {"transform": stamped(transform)})
        return True

    def _finish(self, lookup: _Lookup, outcome: str, result: dict[str, Any]) -> None:
        """Remove a lookup from the waiting ones, and send its result."""
        self._waiting.pop(lookup.goal.id, None)
        self._ended[outcome] += 1
        lookup.goal.succeed(result)

    def _reply_frames(self, _request: dict[str, Any], answer: Answer) -> None:
        answer({"frame_yaml": self._buffer.yaml()})


class _Lookup:
    """The lookup of one goal, with its time limit."""

    def __init__(self, goal: Goal, now: int) -> None:
        self.goal = goal
        self._began = now
        self._until = now + _nanoseconds(goal.goal["timeout"])

    def expired(self, now: int) -> bool:
        """Return whether the time limit has passed, or the clock was set back."""
        return not self._began <= now < self._until

    def run(self, buffer: TransformBuffer) -> Transform:
        """Perform the lookup; raises `TransformError`."""
        request = self.goal.goal
        target, source, stamp = request["target_frame"], request["source_frame"], _nanoseconds(request["source_time"])
        if not request["advanced"]:
            return buffer.lookup_transform(target, source, stamp)
        target_stamp = _nanoseconds(request["target_time"])
        return buffer.lookup_transform_full(target, target_stamp, source, stamp, request["fixed_frame"])


def stamped(transform: Transform) -> dict[str, Any]:
    """Return a transform as ``geometry_msgs/msg/TransformStamped``."""
    seconds, nanoseconds = divmod(transform.stamp, _SECOND)
    x, y, z = transform.translation
    qx, qy, qz, qw = transform.rotation
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": transform.frame_id},
        "child_frame_id": transform.child_frame_id,
        "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": qx, "y": qy, "z": qz, "w": qw}},
    }


def _nanoseconds(time: dict[str, int]) -> int:
    return int(time["sec"]) * _SECOND + int(time["nanosec"])

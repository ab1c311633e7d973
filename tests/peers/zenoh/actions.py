"""Actions of a `tests.peers.zenoh.programs.Ros2ddsBridge`: the services, topics and token that the plugin declares.

Written from zenoh-plugin-ros2dds of August 2026: ``route_action_srv.rs``, ``route_action_cli.rs``, ``ros2_utils.rs``.
The only action is ``tf2_msgs/action/LookupTransform``, whose definition is available everywhere.
"""

from __future__ import annotations

import threading
from typing import Any

import zenoh
from zenoh import ext

from tests.peers.zenoh.programs import Ros2ddsBridge
from tests.peers.zenoh.services import Calling, Serving

ACTION = "tf2_msgs/action/LookupTransform"
EXECUTING, SUCCEEDED, CANCELED, ABORTED = 2, 4, 5, 6
_ID = "unique_identifier_msgs/UUID goal_id\n"
_NAME = "tf2_msgs/LookupTransform"
TEXTS = {
    f"{_NAME}_Goal": "string target_frame\nstring source_frame\nbuiltin_interfaces/Time source_time\n"
    "builtin_interfaces/Duration timeout\nbuiltin_interfaces/Time target_time\nstring fixed_frame\nbool advanced\n",
    f"{_NAME}_Result": "geometry_msgs/TransformStamped transform\ntf2_msgs/TF2Error error\n",
    f"{_NAME}_Feedback": "",
    f"{_NAME}_SendGoal_Request": f"{_ID}tf2_msgs/LookupTransform_Goal goal\n",
    f"{_NAME}_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
    f"{_NAME}_GetResult_Request": _ID,
    f"{_NAME}_GetResult_Response": "int8 status\ntf2_msgs/LookupTransform_Result result\n",
    f"{_NAME}_FeedbackMessage": f"{_ID}tf2_msgs/LookupTransform_Feedback feedback\n",
    "action_msgs/CancelGoal_Request": "action_msgs/GoalInfo goal_info\n",
    "action_msgs/CancelGoal_Response": "int8 return_code\naction_msgs/GoalInfo[] goals_canceling\n",
}
_STATUS = "action_msgs/GoalStatusArray"


class ActionServer:
    """An action server of a bridge's DDS node; it accepts all goals, which run until `end`, also if canceled."""

    def __init__(self, bridge: Ros2ddsBridge, name: str) -> None:
        self.bridge = bridge
        serve = {part: self._serve(name, part, type_) for part, type_ in _SERVICES.items()}
        self.send_goal, self.cancel_goal, self.get_result = serve.values()
        self.send_goal.reply = {"accepted": True}
        self.get_result.held = True
        session = bridge.session
        self.feedback = session.declare_publisher(bridge.key(f"{name}/_action/feedback"))
        self.status = ext.declare_advanced_publisher(
            session, bridge.key(f"{name}/_action/status"), cache=ext.CacheConfig(10), publisher_detection=True
        )
        self.token = bridge.declare_token("AS", name, ACTION)

    def _serve(self, name: str, part: str, type_: str) -> Serving:
        key = self.bridge.key(f"{name}/_action/{part}")
        serving = Serving(self.bridge.session, key, self.bridge.wire, {"type": type_})
        self.bridge.servings[id(serving)] = serving
        return serving

    def goal(self) -> dict[str, Any]:
        """Return the first goal."""
        return self.send_goal.requests()[0]

    def report(self, status: int) -> None:
        """Publish feedback and the goal's status."""
        goal_id = self.goal()["goal_id"]
        self.feedback.put(self.bridge.encode(f"{_NAME}_FeedbackMessage", {"goal_id": goal_id}))
        listed = [{"goal_info": {"goal_id": goal_id}, "status": status}]
        self.status.put(self.bridge.encode(_STATUS, {"status_list": listed}))

    def end(self, status: int, frame: str) -> None:
        """End the goal."""
        self.report(status)
        self.get_result.reply = {"status": status, "result": {"transform": {"child_frame_id": frame}}}
        self.get_result.release()

    def close(self) -> None:
        """Close the node. The plugin undeclares its routes, but keeps pending queries."""
        self.token.undeclare()
        for serving in (self.send_goal, self.cancel_goal, self.get_result):
            serving.undeclare()
        self.feedback.undeclare()
        del self.status


class ActionClient:
    """An action client of a bridge's DDS node."""

    def __init__(self, bridge: Ros2ddsBridge, name: str) -> None:
        self.bridge, self.name = bridge, name
        self.token = bridge.declare_token("AC", name, ACTION)
        self.feedback: list[Any] = []
        self.statuses: list[Any] = []
        session = bridge.session
        self._changed = threading.Condition()

        def collect(received: list[Any], type_: str) -> zenoh.handlers.Callback:
            return zenoh.handlers.Callback(
                lambda sample: received.append(bridge.decode(type_, sample.payload.to_bytes())), indirect=False
            )

        self._parts: list[zenoh.Subscriber | ext.AdvancedSubscriber] = [
            session.declare_subscriber(
                bridge.key(f"{name}/_action/feedback"), collect(self.feedback, f"{_NAME}_FeedbackMessage")
            ),
            ext.declare_advanced_subscriber(
                session, bridge.key(f"{name}/_action/status"), collect(self.statuses, _STATUS),
                history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
            ),
        ]  # fmt: skip

    def ask(self, part: str, request: dict[str, Any] | bytes | None) -> Calling:
        """Call one of the action's services."""
        key = self.bridge.key(f"{self.name}/_action/{part}")
        return Calling(self.bridge.session, key, self.bridge.wire, _SERVICES[part], request)

    def close(self) -> None:
        self.token.undeclare()
        for part in self._parts:
            part.undeclare()


_SERVICES = {
    "send_goal": f"{_NAME}_SendGoal",
    "cancel_goal": "action_msgs/CancelGoal",
    "get_result": f"{_NAME}_GetResult",
}

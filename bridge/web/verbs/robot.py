"""The commands of pages to the robot: goals, stops, the planner, the pose and the map."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any

from bridge.client.actions import ActionClient, SentGoal
from bridge.client.halt import halt
from bridge.client.services import ServiceClient
from bridge.client.session import Client
from bridge.client.store import StoreClient
from bridge.client.types import Types
from bridge.config.model import Config
from bridge.config.sections.navigation import ACTION
from bridge.hub.endpoints.calls import Abandon, CallError
from bridge.hub.wire.qos import Qos
from bridge.modules.endpoints import ModulePublisher
from bridge.modules.host import Host
from bridge.web.verbs.explaining import explain
from bridge.web.verbs.verbs import PageVerb, VerbError, name_of, number_of
from navigation.constraints import Constraints
from navigation.localization_server.section import LocalizationServerSection
from navigation.messages import NAVIGATE, pose_message
from navigation.pose import Pose

TRIGGER, NAMED, POSE_COVARIANCE = (
    "std_srvs/srv/Trigger", "midspan_msgs/srv/Named", "geometry_msgs/msg/PoseWithCovarianceStamped",
)  # fmt: skip
ANSWER_SECONDS, STOP_SECONDS = 5.0, 12.0
GOAL_SECONDS = 5.0
_COVARIANCE = {0: 0.25, 7: 0.25, 35: 0.07}
"""Covariance of a pose set by a person, as in RViz: m^2 and rad^2 on the diagonal of x, y and heading."""


class RobotVerbs:
    """The verbs that command the robot. They block, so they never run on the module's thread.

    Args:
        on_planner: called with the chosen planner, on the module's thread.
        pause_or_resume: pauses or resumes a patrol between two goals; returns the reply, or "" to ask the gateway.
    """

    def __init__(
        self,
        host: Host,
        config: Config,
        client: Client,
        types: Types,
        store: Callable[[], StoreClient],
        *,
        on_planner: Callable[[str], None],
        pause_or_resume: Callable[[str], str],
    ) -> None:
        self._host, self._config, self._client, self._types, self._store = host, config, client, types, store
        self._on_planner, self._pause_or_resume = on_planner, pause_or_resume
        self._clients: dict[str, ServiceClient] = {}
        self._goals: ActionClient | None = None
        self._starts: ModulePublisher | None = None

    def verbs(self) -> dict[str, PageVerb]:
        """Return the verbs by their names."""
        xy, pose = dict.fromkeys(("x", "y"), number_of), dict.fromkeys(("x", "y", "theta"), number_of)
        named = {"name": name_of}
        return {
            "goto": PageVerb(self._goto, xy, {"theta": number_of}, drives=True),
            "goto_place": PageVerb(partial(self._call_with_name, "go_to"), named, {}, drives=True),
            "stop": PageVerb(self._stop, {}, {}, stops=True),
            "pause": PageVerb(partial(self._pause, "pause"), {}, {}, stops=True),
            "resume": PageVerb(partial(self._pause, "resume"), {}, {}, drives=True),
            "halt": PageVerb(self._halt, {}, {}, stops=True),
            "choose_planner": PageVerb(self._choose, named, {}),
            "set_pose": PageVerb(self._set_pose, pose, {}),
            "use_map": PageVerb(lambda name: self._store().use_map(name), named, {}),
            "ping": PageVerb(lambda: None, {}, {}, commands=False),
            "explain": PageVerb(lambda name: explain(self._client, name), named, {}, commands=False),
        }

    def _goto(self, x: float, y: float, theta: float | None = None) -> str:
        """Send a goal; return once the gateway has accepted it."""
        pose = {"header": {"frame_id": self._config.navigation.frame}, "pose": pose_message(Pose(x, y, theta or 0.0))}
        goal: dict[str, Any] = {"pose": pose}
        if theta is None:
            goal["behavior_tree"] = Constraints(heading=False).to_text()
        done: Future[str] = Future()

        def check_accepted(sent: SentGoal) -> None:
            if done.done():
                return
            if sent.accepted:
                done.set_result(f"driving to {x:.2f}, {y:.2f} m")
            else:
                self._host.loop.after(0.02, lambda: check_accepted(sent))

        def ended(_goal: SentGoal, result: dict[str, Any] | None, why: str) -> None:
            if not done.done():
                reason = why or (result or {}).get("error_msg", "") or "the goal ended immediately"
                done.set_exception(VerbError(reason))

        def send() -> SentGoal:
            self._goals = self._goals or self._host.node.action_client(ACTION, NAVIGATE)
            sent = self._goals.send(goal, ended)
            check_accepted(sent)
            return sent

        sent: SentGoal = self._host.loop.call(send, late=False)
        try:
            return done.result(GOAL_SECONDS)
        except TimeoutError:
            done.cancel()
            self._host.loop.post(sent.cancel)  # a late start would be unexpected
            raise VerbError(f"the gateway did not accept or reject the goal within {GOAL_SECONDS:g} s") from None

    def cancel_starting(self) -> None:
        """Cancel goals of pages that the gateway has not accepted yet; called on the module's thread before a stop."""
        if self._goals is not None:
            self._goals.cancel_starting()

    def _trigger(self, name: str, seconds: float = ANSWER_SECONDS) -> str:
        return self._ask(f"/navigation/{name}", TRIGGER, {}, seconds, late=name != "resume")

    def _pause(self, name: str) -> str:
        reply: str = self._host.loop.call(lambda: self._pause_or_resume(name), late=name != "resume")
        return reply or self._trigger(name)

    def _stop(self) -> str:
        return self._trigger("stop", STOP_SECONDS)

    def _call_with_name(self, service: str, name: str) -> str:
        return self._ask(f"/navigation/{service}", NAMED, {"name": name}, ANSWER_SECONDS)

    def _choose(self, name: str) -> str:
        reply = self._call_with_name("choose_planner", name)
        self._host.loop.post(lambda: self._on_planner(name))
        return reply

    def _ask(self, name: str, type_name: str, request: dict[str, Any], seconds: float, *, late: bool = False) -> str:
        """Call a service that replies with ``success`` and ``message``; return the message.

        ``late``: whether the request remains valid after ``seconds``, as a stop does; the robot must not drive then.
        """
        done: Future[dict[str, Any] | CallError] = Future()

        def call() -> Abandon:
            client = self._clients.get(name) or self._host.node.client(name, type_name)
            self._clients[name] = client
            return client.call(request, done.set_result)

        abandon: Abandon = self._host.loop.call(call, late=late)
        try:
            reply = done.result(seconds)
        except TimeoutError:
            if not late:
                abandon()
            raise VerbError(f"{name} has not answered in {seconds:g} s") from None
        if isinstance(reply, CallError):
            raise VerbError(f"{name}: {reply}")
        if not reply["success"]:
            raise VerbError(str(reply["message"]) or f"{name} refused")
        return str(reply["message"])

    def _halt(self) -> str:
        result = halt(self._client, self._types)
        troubles = [f"{name}: {problem}" for name, problem in result.bases.items() if problem]
        troubles += [f"{cancel.name}: cannot cancel its goals: {cancel.error}" for cancel in result.failed]
        if result.trouble or troubles:
            raise VerbError("; ".join(filter(None, (result.trouble, *troubles))))
        return (
            "all responding bases stand still" if result.bases else "published zero velocity, but no base has responded"
        )

    def _set_pose(self, x: float, y: float, theta: float) -> str:
        topic = self._config.section(LocalizationServerSection).initialpose
        if not topic or not self._host.node.hub.graph.subscriptions(topic):
            raise VerbError(
                f"{topic or 'the initial pose'} has no subscriber: check that the localizer runs and is bridged"
            )
        covariance = [_COVARIANCE.get(at, 0.0) for at in range(36)]
        message = {
            "header": {"stamp": self._host.clock.stamp(), "frame_id": self._config.navigation.frame},
            "pose": {"pose": pose_message(Pose(x, y, theta)), "covariance": covariance},
        }

        def publish() -> None:
            self._starts = self._starts or self._host.node.publisher(topic, POSE_COVARIANCE, Qos(depth=1))
            self._starts.publish(message)

        self._host.loop.call(publish)
        return f"sent to the localizer: the robot is at {x:.2f}, {y:.2f} m"

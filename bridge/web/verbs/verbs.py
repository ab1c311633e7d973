"""The commands and queries of pages: goals, stops, places, explanations. Each command is logged with its client."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any

from bridge.client.actions import ActionClient, SentGoal
from bridge.client.errors import ClientError
from bridge.client.halt import halt
from bridge.client.services import ServiceClient
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.concurrency import WorkerPool
from bridge.config.model import Config
from bridge.config.sections.navigation import ACTION
from bridge.hub.endpoints.calls import CallError
from bridge.hub.errors import HubError
from bridge.hub.wire.qos import Qos
from bridge.modules.endpoints import ModulePublisher
from bridge.modules.host import Host
from bridge.stores.client import StoreClient
from bridge.stores.entry import StoreError
from bridge.web.verbs.explaining import explain
from navigation.constraints import Constraints
from navigation.localization_server.section import LocalizationServerSection
from navigation.messages import NAVIGATE, pose_message
from navigation.pose import Pose

_log = logging.getLogger("midspan.web")

TRIGGER, NAMED, POSE_COVARIANCE = (
    "std_srvs/srv/Trigger", "midspan_msgs/srv/Named", "geometry_msgs/msg/PoseWithCovarianceStamped",
)  # fmt: skip
ANSWER_SECONDS, STOP_SECONDS = 5.0, 12.0
GOAL_SECONDS = 5.0
BEGIN_SECONDS = 3.0
"""A call that had to wait this long for others is not executed."""
THREADS = 4
"""Concurrent calls, besides slow ones and stops."""
_STOP_THREADS = 2
_SLOW_THREADS = 3
_COVARIANCE = {0: 0.25, 7: 0.25, 35: 0.07}
"""Covariance of a pose set by a person, as in RViz: m^2 and rad^2 on the diagonal of x, y and heading."""


class VerbError(RuntimeError):
    """A page's call failed; the text is the reason."""


@dataclass(frozen=True)
class PageVerb:
    """One verb: its required and optional arguments, each with a check, and its function.

    A ``slow`` verb may take long, and runs on separate threads.
    """

    run: Callable[..., Any]
    needs: Mapping[str, Callable[[Any], Any]]
    may: Mapping[str, Callable[[Any], Any]]
    commands: bool = True
    stops: bool = False
    logged: bool = True  #: applies to commands
    slow: bool = False


def number_between(least: float, most: float, unit: str = "") -> Callable[[Any], float]:
    """Return the check of a number within limits; ``unit`` is part of the error."""

    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
            raise ValueError(f"must be a number{unit} between {least:,.15g} and {most:,.15g}")
        return float(value)

    return check


MOST_NUMBER = 1e6
number_of = number_between(-MOST_NUMBER, MOST_NUMBER)
"""Check a position in meters or a heading in radians."""


def name_of(value: Any) -> str:
    """Check a name."""
    if not isinstance(value, str) or not value.strip() or len(value) > 255:
        raise ValueError("must be a name of up to 255 characters")
    return value.strip()


def truth_of(value: Any) -> bool:
    """Check a truth value."""
    if value is True or value is False:
        return bool(value)
    raise ValueError("must be true or false")


class Verbs:
    """Runs the verbs. `begin` may be called on any thread.

    Args:
        on_planner: called with the chosen planner, on the module's thread.
        before: called on the module's thread before the verb of that name starts.
        pause_or_resume: pauses or resumes a patrol between two goals; returns its reply, "" if it is up to the gateway.
        more: verbs of other modules.

    Attributes:
        known: the verbs that pages may call, by name.
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
        before: Mapping[str, Callable[[], None]],
        pause_or_resume: Callable[[str], str],
        more: Mapping[str, PageVerb],
    ) -> None:
        self._host, self._config, self._client, self._types, self._store = host, config, client, types, store
        self._on_planner, self._before, self._pause_or_resume = on_planner, before, pause_or_resume
        self._pool = WorkerPool(THREADS, "midspan-web-call")
        self._slow = WorkerPool(_SLOW_THREADS, "midspan-web-slow")
        self._lock = threading.Lock()
        self._clients: dict[str, ServiceClient] = {}
        self._goals: ActionClient | None = None
        self._starts: ModulePublisher | None = None
        xy, pose = dict.fromkeys(("x", "y"), number_of), dict.fromkeys(("x", "y", "theta"), number_of)
        named = {"name": name_of}
        self.known = {
            "goto": PageVerb(self._goto, xy, {"theta": number_of}),
            "goto_place": PageVerb(partial(self._named, "go_to"), named, {}),
            "stop": PageVerb(self._stop, {}, {}, stops=True),
            "pause": PageVerb(partial(self._pause, "pause"), {}, {}, stops=True),
            "resume": PageVerb(partial(self._pause, "resume"), {}, {}),
            "halt": PageVerb(self._halt, {}, {}, stops=True),
            "choose_planner": PageVerb(self._choose, named, {}),
            "set_pose": PageVerb(self._set_pose, pose, {}),
            "use_map": PageVerb(lambda name: self._store().use_map(name), named, {}),
            "ping": PageVerb(lambda: None, {}, {}, commands=False),
            "explain": PageVerb(lambda name: explain(client, name), named, {}, commands=False),
            **more,
        }
        stops = [name for name, verb in self.known.items() if verb.stops]
        self._stops = {name: WorkerPool(_STOP_THREADS, f"midspan-web-{name}") for name in stops}
        self._newest: dict[str, Future[Any]] = {}

    def is_stop(self, verb: str) -> bool:
        """Return whether a verb stops robots; such a call is never refused because of the load."""
        return verb in self.known and self.known[verb].stops

    def is_command(self, verb: str) -> bool:
        """Return whether a verb is a command, which needs the role ``drive``."""
        return verb in self.known and self.known[verb].commands

    def begin(self, verb: str, args: Mapping[str, Any], who: str) -> Future[Any]:
        """Run a verb on a thread that may block; the future has the result or a `VerbError`. Raises `VerbError`."""
        page_verb = self.known.get(verb)
        if page_verb is None:
            raise VerbError(f"unknown verb {verb[:80]!r}; known: {', '.join(self.known)}")
        checked = _checked(verb, page_verb, args)
        if page_verb.commands and page_verb.logged:
            arguments = " ".join(f"{key}={value!r}"[:100] for key, value in args.items())
            _log.info("%s: %s %s", who, verb, arguments)
        if verb in self._before:
            self._host.loop.post(self._before[verb])
        job = partial(_run, page_verb.run, checked, math.inf if page_verb.stops else time.monotonic() + BEGIN_SECONDS)
        if page_verb.stops:
            return self._begin_stop(verb, job)
        return (self._slow if page_verb.slow else self._pool).submit(job)

    def _begin_stop(self, verb: str, job: Callable[[], Any]) -> Future[Any]:
        """Run a stop, which waits for no other verb; while two of its kind run, further callers share the next one."""
        with self._lock:
            newest = self._newest.get(verb)
            if newest is None or newest.running() or newest.done():
                newest = self._newest[verb] = self._stops[verb].submit(job)
            return newest

    def close(self) -> None:
        self._pool.close(1.0)
        self._slow.close(1.0)
        for pool in self._stops.values():
            pool.close(1.0)

    # -- on threads that may block -------------------------------------------------------------------------------------

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

        sent: SentGoal = self._host.loop.call(send)
        try:
            return done.result(GOAL_SECONDS)
        except TimeoutError:
            done.cancel()
            self._host.loop.post(sent.cancel)  # a late start would be unexpected
            raise VerbError(f"the gateway did not accept or reject the goal within {GOAL_SECONDS:g} s") from None

    def _trigger(self, name: str, seconds: float = ANSWER_SECONDS) -> str:
        return self._ask(f"/navigation/{name}", TRIGGER, {}, seconds)

    def _pause(self, name: str) -> str:
        reply: str = self._host.loop.call(lambda: self._pause_or_resume(name))
        return reply or self._trigger(name)

    def _stop(self) -> str:
        return self._trigger("stop", STOP_SECONDS)

    def _named(self, service: str, name: str) -> str:
        return self._ask(f"/navigation/{service}", NAMED, {"name": name}, ANSWER_SECONDS)

    def _choose(self, name: str) -> str:
        reply = self._named("choose_planner", name)
        self._host.loop.post(lambda: self._on_planner(name))
        return reply

    def _ask(self, name: str, type_name: str, request: dict[str, Any], seconds: float) -> str:
        """Call a service that replies with ``success`` and ``message``; return the message."""
        done: Future[dict[str, Any] | CallError] = Future()

        def call() -> None:
            client = self._clients.get(name) or self._host.node.client(name, type_name)
            self._clients[name] = client
            client.call(request, done.set_result)

        self._host.loop.call(call)
        try:
            reply = done.result(seconds)
        except TimeoutError:
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


def _run(action: Callable[..., Any], args: dict[str, Any], latest: float) -> Any:
    if time.monotonic() > latest:  # a late start would be unexpected
        raise VerbError(f"not executed: other calls delayed it by more than {BEGIN_SECONDS:g} s; try again")
    try:
        return action(**args)
    except (ClientError, HubError, StoreError, TimeoutError) as err:
        raise VerbError(str(err)) from None


def _checked(verb: str, page_verb: PageVerb, args: Mapping[str, Any]) -> dict[str, Any]:
    known = {**page_verb.needs, **page_verb.may}
    for key in args:
        if key not in known:
            raise VerbError(f"{verb} has no argument {str(key)[:80]!r}; it has {', '.join(known) or 'none'}")
    for key in page_verb.needs:
        if key not in args:
            raise VerbError(f"{verb} needs {key}")
    checked = {}
    for key, value in args.items():
        try:
            checked[key] = known[key](value)
        except ValueError as err:
            raise VerbError(f"{verb}: {key} {err}, not {value!r:.80}") from None
    return checked

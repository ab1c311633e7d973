"""Halts everything on the hub: publishes zero velocities, cancels all goals, and asks bases and the gateway to halt.

The steps are independent: none waits for another, or fails because another fails. The goals of each action are a
separate step.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from typing_extensions import override

from bridge.client.publishing import encode
from bridge.client.services import WAIT_SECONDS, ServiceClient
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.client.velocity import driven_forms, subscribers, velocity_message
from bridge.clock import RunClock
from bridge.config.sections.navigation import NavigationSection
from bridge.hub.control import MANUAL_DRIVING_HALTED, RECORDED
from bridge.hub.endpoints.calls import CallError
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import CANCEL as CANCEL_TYPE
from bridge.messages.actions import CANCEL_GOAL, CancelCode, part_name
from bridge.messages.velocities import VELOCITIES

CANCEL = part_name("", CANCEL_GOAL)

DEFAULT_SECONDS = 2.0
"""Seconds for which zero is repeated, so that it also reaches a side whose route for the topic is yet to be created."""

_PERIOD = 0.05
_ANSWER_SECONDS = 5.0
"""Seconds to wait for the modules; the gateway answers only when the stop is confirmed."""

_REPLY_SECONDS = 1.0
"""Seconds to wait for the reply to a request to cancel goals, even beyond the requested time."""

_ALL: dict[str, Any] = {"goal_info": {}}
"""A `CancelGoal` request without id and stamp: all goals (action_msgs/srv/CancelGoal)."""

_Kind = tuple[str, str, str]
"""Name, type and type hash of a topic."""


@dataclass(frozen=True)
class Halted:
    """What was halted.

    Attributes:
        topics: the velocity topics, with their number of subscribers on the hub.
        cancels: the result for each action's goals.
        bases: for each module that was asked to halt, why its base may still move; "" if it has halted.
        trouble: why the configured planner may still be driving, or a base may still move; "" otherwise.
        published: name, type and type hash of each velocity topic.
    """

    topics: dict[str, int]
    cancels: list[GoalCancellation]
    bases: dict[str, str]
    trouble: str
    published: list[_Kind] = field(default_factory=list)

    @property
    def failed(self) -> list[GoalCancellation]:
        """The actions whose goals could not be canceled."""
        return [cancel for cancel in self.cancels if cancel.error]


def halt(client: Client, types: Types, seconds: float = DEFAULT_SECONDS) -> Halted:
    """Halt everything on the hub; see `stop` for ``seconds``."""
    bases = _Bases(client)
    stopped = stop(client, types, actions(client), seconds)
    bases.join()
    canceled = [cancel.name for cancel in stopped.cancels]
    trouble = unreached(client.config.navigation, bases.answers, canceled)
    texts = filter(None, (trouble, bases.trouble, stopped.trouble))
    return Halted(stopped.topics, stopped.cancels, bases.answers, "; ".join(texts), stopped.published)


@dataclass(frozen=True)
class Stopped:
    """The topics that received zero, the canceled goals, and why a base may not have received zero; see `Halted`."""

    topics: dict[str, int]
    cancels: list[GoalCancellation]
    trouble: str
    published: list[_Kind]


def stop(client: Client, types: Types, names: Iterable[str], seconds: float) -> Stopped:
    """Publish zero for ``seconds``, and meanwhile cancel the goals of these actions.

    Zero is published at least half as often as in that time, even if this process is starved or suspended meanwhile.
    If an action's server is not reachable yet, continue until it is reachable, for up to `WAIT_SECONDS`; then until it
    has replied, for up to `_REPLY_SECONDS`.
    """
    zeros = ZeroVelocities(client, types)
    cancels = [GoalCancellation(client, types, name) for name in names]
    begin, never, rounds = time.monotonic(), threading.Event(), 0
    while True:
        zeros.put()
        rounds += 1
        for cancel in cancels:
            cancel.attempt()
        elapsed = time.monotonic() - begin
        waits = elapsed < WAIT_SECONDS and any(cancel.waits for cancel in cancels)
        over = elapsed >= seconds and rounds * _PERIOD * 2.0 >= seconds
        if over and not waits and not any(cancel.pending for cancel in cancels):
            break
        never.wait(_PERIOD)
    result = Stopped(zeros.listeners(), cancels, zeros.trouble(), zeros.published)
    zeros.close()
    for cancel in cancels:
        cancel.close()
    return result


def unreached(section: NavigationSection, asked: Iterable[str], canceled: Collection[str]) -> str:
    """Return a text if neither the gateway nor the configured planner is on the hub, so it may still drive; else ""."""
    planner = section.planner
    if not planner or section.at(planner) in canceled or any(worker.split()[0] == "gateway" for worker in asked):
        return ""
    return (
        f"neither the gateway nor the planner {planner} is on the hub now, so neither could be asked to stop: the robot"
        " may still be moving; ask again, and see `midspan status`"
    )


def actions(client: Client) -> list[str]:
    """Return the names of the actions that are served on the hub."""
    servers = (e for e in client.hub.graph.servers() if e.type_name == CANCEL_TYPE)
    return sorted({e.topic.removesuffix(CANCEL) for e in servers if e.topic.endswith(CANCEL)})


class ZeroVelocities:
    """Publishes zero velocity on every velocity topic of the hub, and on those that nodes of a side subscribe to.

    On a side, a topic has either ``Twist`` or ``TwistStamped``. If all subscribers of a topic accept only one of the
    two, zero is published as that type; also as the type that a route already carries, because a side may not announce
    the base behind the route. Otherwise it is published as both. A failure on one topic does not affect the others.
    """

    def __init__(self, client: Client, types: Types) -> None:
        self._hub, self._types, self._frame = client.hub, types, client.config.navigation.base_frame
        self._clock = RunClock(simulated=client.config.clock.simulated)  # not fed from /clock: simulated stamps are 0
        self._publishers: dict[_Kind, HubPublisher] = {}
        self._failed: dict[_Kind, str] = {}

    @property
    def published(self) -> list[_Kind]:
        """Name, type and type hash of each topic on which zero is published."""
        return sorted(self._publishers)

    def put(self) -> None:
        """Publish zero once on each topic, including new topics."""
        for kind in self._find_topics() - self._publishers.keys() - self._failed.keys():
            with self._record_failure(kind):
                self._publishers[kind] = self._hub.publisher(*kind, Qos(depth=1), priority="command")
        for kind, publisher in self._publishers.items():
            with self._record_failure(kind):
                message = velocity_message(kind[1], self._clock, self._frame)
                publisher.put(encode(self._types, kind[1], message))

    def _find_topics(self) -> set[_Kind]:
        graph = self._hub.graph
        ends = [*graph.publishers(), *graph.subscriptions()]
        known = {(e.topic, e.type_name, e.type_hash) for e in ends if e.type_name in VELOCITIES}
        for _, topic, name in graph.velocities():
            if name in VELOCITIES:
                with self._record_failure((topic, name, NO_HASH)):
                    known.add((topic, name, self._types.hash_of(name)))
        topics = {topic for topic, _, _ in known}
        forms = {topic: driven_forms(graph, topic) if subscribers(graph, topic) else VELOCITIES for topic in topics}
        return {kind for kind in known if kind[1] in forms[kind[0]]}

    @contextmanager
    def _record_failure(self, kind: _Kind) -> Iterator[None]:
        try:
            yield
        except Exception as err:  # of any kind; the other topics must get zero nevertheless
            self._failed[kind] = _reason(err)

    def listeners(self) -> dict[str, int]:
        """Return the topics on which zero is published, with their number of subscribers on the hub."""
        return {topic: len(self._hub.graph.subscriptions(topic)) for topic, _, _ in self.published}

    def trouble(self) -> str:
        """Return a text with the topics on which zero failed, or does not reach nodes of a side; "" for none."""
        graph = self._hub.graph
        failed = [
            f"{topic}: zero could not be published as {name} ({error}): the robot may still be moving"
            for (topic, name, _), error in sorted(self._failed.items())
        ]
        published = {kind[:2] for kind in self._publishers}
        reached = {(end.zid, end.topic, end.type_name) for end in graph.subscriptions()}
        missed = [
            f"{topic}: nodes of a side subscribe to {name}, and zero does not reach them: the robot may still be"
            f" moving; see 'midspan explain {topic}'"
            for zid, topic, name in graph.velocities()
            if (zid, topic, name) not in reached or (topic, name) not in published
        ]
        return "; ".join([*failed, *missed])

    def close(self) -> None:
        """Close the publishers."""
        for publisher in self._publishers.values():
            publisher.close()


class GoalCancellation:
    """Cancels all goals of one action; ``found`` is the number of its goals, ``error`` the reason for a failure.

    The request has the installed definition of `CancelGoal`, which all releases of ROS 2 share, so that no worker needs
    to be asked for the definition.
    """

    def __init__(self, client: Client, types: Types, name: str) -> None:
        from bridge.messages.json import CallCodec  # many programs cancel nothing

        self.name, self.found, self.error = name, 0, f"the server of {name}{CANCEL} does not accept calls from here"
        self._end: ServiceClient | None = None
        self.waits = False
        self._asked: float | None = None  # when the request was sent, until its reply
        try:
            self._end = ServiceClient(client.hub, f"{name}{CANCEL}", CallCodec(types.registry, CANCEL_TYPE))
            self.waits = True
        except Exception as err:  # of any kind; the rest must stop nevertheless
            self.error = _reason(err)

    def attempt(self) -> None:
        """Send the request once, as soon as the server is reachable."""
        if self._end is None or not self.waits or not self._end.ready:
            return
        self.waits, self.error, self._asked = False, "it has not answered", time.monotonic()
        try:
            self._end.call(_ALL, self._on_reply)
        except Exception as err:  # of any kind; the rest must stop nevertheless
            self._asked, self.error = None, _reason(err)

    @property
    def pending(self) -> bool:
        """Whether a reply may still arrive in time."""
        return self._asked is not None and time.monotonic() < self._asked + _REPLY_SECONDS

    def close(self) -> None:
        """Close the client; a later answer is ignored."""
        end, self._end = self._end, None
        if end is not None:
            end.close()

    def _on_reply(self, reply: dict[str, Any] | CallError) -> None:
        if self._end is None:
            return
        self._asked = None
        if isinstance(reply, CallError):
            self.error = str(reply)
            return
        self.found, self.error = len(reply["goals_canceling"]), ""
        if not self.found and reply["return_code"] == CancelCode.REJECTED:
            self.error = "its server rejected the request, so its goals continue"


class _Bases(threading.Thread):
    """Asks all modules with a base, and the gateway, to halt.

    Attributes:
        answers: for each module that was asked, why its base may still move; "" if it has halted.
        trouble: why further bases may still move, "" otherwise.
    """

    def __init__(self, client: Client) -> None:
        super().__init__(name="halt", daemon=True)
        self._client = client
        self.answers: dict[str, str] = {}
        self.trouble = ""
        self.start()

    @override
    def run(self) -> None:
        begin = time.monotonic()
        try:
            answers = self._client.ask("halt", timeout=_ANSWER_SECONDS)
        except Exception as err:  # of any kind; the rest must stop nevertheless, and the failure is reported
            self.trouble = f"bases could not be asked to halt and may still be moving: {_reason(err)}"
            return
        for answer in answers:
            if answer.value not in (RECORDED, MANUAL_DRIVING_HALTED):
                name = f"{answer.worker} of {answer.daemon}"  # several modules may have this name
                self.answers[name] = self.answers.get(name) or answer.error or _unconfirmed(answer.value)
        if time.monotonic() - begin >= _ANSWER_SECONDS:
            self.trouble = (
                f"a module has not answered within {_ANSWER_SECONDS:g} s: its base may still be moving; see"
                " `midspan status`"
            )


def _unconfirmed(value: Any) -> str:
    """Return why a module's answer does not confirm the halt, "" if it does."""
    halted = isinstance(value, dict) and value.get("halted") is True
    return "" if halted else f"its answer does not confirm the halt: {value!r:.80}"


def _reason(err: Exception) -> str:
    return str(err) or type(err).__name__

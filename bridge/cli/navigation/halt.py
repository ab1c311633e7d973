"""``midspan halt``: stop every base, cancel every goal."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Any

from bridge.cli.arguments import add_hub_arguments
from bridge.cli.client import CliClient, open_client, warn_of_daemon
from bridge.cli.graph.caller import ServiceCaller
from bridge.cli.inspection.refusals import warn_of_refusals
from bridge.cli.messages import Types
from bridge.cli.output import CliError, clean, plural, print_json
from bridge.config.sections.navigation import NavigationSection
from bridge.hub.control import RECORDED
from bridge.hub.endpoints.calls import CallError
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import CANCEL_GOAL, part_name
from bridge.messages.json import from_json

VELOCITIES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
CANCEL = part_name("", CANCEL_GOAL)

DEFAULT_SECONDS = 2.0
"""Seconds for which zero is repeated: a topic that only now crosses to a side reaches it within this time."""

_PERIOD = 0.05
_ANSWER_SECONDS = 5.0
"""The gateway waits for the confirmation of the stop."""

_ALL: dict[str, Any] = {"goal_info": {}}
"""A `CancelGoal` request without id and stamp: all goals (action_msgs/srv/CancelGoal)."""


def register(parser: argparse.ArgumentParser) -> None:
    """Describe the verb and its arguments."""
    parser.description = (
        "Publishes zero on every topic of velocities on the hub (the rules decide which sides it reaches), clears the"
        " commands of each BaseControl and the goals of the gateway and Midspan's planners, and cancels every goal of"
        " every action. It is not an emergency stop: later commands are obeyed. Exit code 1 if something did not"
        " answer, or if it is not confirmed that the robot stands."
    )
    parser.epilog = "Example: midspan halt"
    parser.add_argument(
        "--seconds",
        type=float,
        default=DEFAULT_SECONDS,
        help=f"repeat zero for this long (default {DEFAULT_SECONDS:g})",
    )
    parser.add_argument("--json", action="store_true", help="print what was halted as JSON")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


@dataclass(frozen=True)
class Halted:
    """What was halted.

    Attributes:
        topics: the topics of velocities, with their number of subscribers on the hub.
        cancels: the result for each action's goals.
        bases: the modules that were asked to halt, and why they may not stand; "" if they do.
        trouble: why the configured planner may drive on; "" if it does not.
        published: name, type and type hash of each topic of velocities.
    """

    topics: dict[str, int]
    cancels: list[GoalCancellation]
    bases: dict[str, str]
    trouble: str
    published: list[tuple[str, str, str]] = field(default_factory=list)

    @property
    def failed(self) -> list[GoalCancellation]:
        """The actions whose goals could not be cancelled."""
        return [cancel for cancel in self.cancels if cancel.error]


def run(args: argparse.Namespace) -> int:
    """Halt everything; return 1 if something did not answer."""
    with open_client(args, warn=False) as client:
        client.settle()
        result = halt(client, Types(client), args.seconds)
        refused = warn_of_refusals(client, result.published)
        warn_of_daemon(args, client.config, workers=False)  # not before: a daemon that hangs takes a second to ask
    if args.json:
        errors = {cancel.name: cancel.error for cancel in result.failed}
        errors |= {base: reason for base, reason in result.bases.items() if reason}
        errors |= {"navigation": result.trouble} if result.trouble else {}
        goals = {cancel.name: cancel.found for cancel in result.cancels}
        stands = {base: not reason for base, reason in result.bases.items()}
        print_json({"topics": result.topics, "goals": goals, "bases": stands, "errors": errors})
    else:
        _print_result(result.topics, result.cancels, result.bases)
    if result.trouble:
        raise CliError(result.trouble)
    if not (result.topics or result.cancels or result.bases):
        raise CliError("nothing to halt: the hub has no topic of velocities, no action and no BaseControl")
    return 1 if result.failed or any(result.bases.values()) or refused else 0


def halt(client: CliClient, types: Types, seconds: float = DEFAULT_SECONDS) -> Halted:
    """Halt everything on the hub, and repeat zero for some seconds."""
    zeros = ZeroVelocities(client, types)
    cancels = [GoalCancellation(client, types, name) for name in actions(client)]
    zeros.put()
    bases: dict[str, str] = {}
    asking = threading.Thread(target=lambda: bases.update(_halted(client)), daemon=True)
    asking.start()
    end = time.monotonic() + seconds
    never = threading.Event()
    while time.monotonic() < end:
        never.wait(_PERIOD)
        zeros.put()
    asking.join()  # it has its own time limit
    topics = {topic: zeros.listeners(topic) for topic in zeros.topics}
    zeros.close()
    trouble = unreached(client.config.navigation, bases, [cancel.name for cancel in cancels])
    return Halted(topics, cancels, bases, trouble, zeros.published)


def unreached(section: NavigationSection, asked: Iterable[str], cancelled: Collection[str]) -> str:
    """Why the configured planner may drive on: neither it nor the gateway is on the hub; else ""."""
    planner = section.planner
    if not planner or section.at(planner) in cancelled or any(worker.split()[0] == "gateway" for worker in asked):
        return ""
    return (
        f"neither the gateway nor the planner {planner} is on the hub now, so none could be asked to stop: the robot"
        " may still be moving; ask again, and see `midspan status`"
    )


def actions(client: CliClient) -> list[str]:
    """The names of the actions that are served on the hub."""
    return sorted({e.topic.removesuffix(CANCEL) for e in client.hub.graph.servers() if e.topic.endswith(CANCEL)})


class ZeroVelocities:
    """Publishes zero velocity on every topic of velocities on the hub."""

    def __init__(self, client: CliClient, types: Types) -> None:
        graph = client.hub.graph
        self._graph = graph
        ends = [*graph.publishers(), *graph.subscriptions()]
        topics = sorted({(e.topic, e.type_name, e.type_hash) for e in ends if e.type_name in VELOCITIES})
        self.published = topics
        self.topics = [topic for topic, _, _ in topics]
        self._publishers: list[tuple[HubPublisher, bytes]] = []
        for topic, name, type_hash in topics:
            publisher = client.hub.publisher(topic, name, type_hash, Qos(depth=1), priority="command")
            self._publishers.append((publisher, from_json(types.registry, name, {})))

    def put(self) -> None:
        """Publish zero once on each topic."""
        for publisher, zero in self._publishers:
            publisher.put(zero)

    def listeners(self, topic: str) -> int:
        """Return a topic's number of subscribers on the hub."""
        return len(self._graph.subscriptions(topic))

    def close(self) -> None:
        """Withdraw the publishers."""
        for publisher, _ in self._publishers:
            publisher.close()


class GoalCancellation:
    """Cancels all goals of one action; ``found`` counts them, ``error`` is the reason of a failure."""

    def __init__(self, client: CliClient, types: Types, name: str) -> None:
        self.name, self.found, self.error = name, 0, "it has not answered"
        try:
            ServiceCaller(client, types, f"{name}{CANCEL}").call(_ALL, self._answered)
        except CliError as err:
            self.error = str(err)

    def _answered(self, reply: dict[str, Any] | CallError) -> None:
        if isinstance(reply, CallError):
            self.error = str(reply)
            return
        self.found, self.error = len(reply["goals_canceling"]), ""


def _halted(client: CliClient) -> dict[str, str]:
    """Return the modules that were asked to halt, and why they may not stand; "" if they do."""
    answers = client.ask("halt", timeout=_ANSWER_SECONDS)
    return {f"{a.worker} of {a.daemon}": a.error for a in answers if a.value != RECORDED}


def _print_result(topics: dict[str, int], cancels: list[GoalCancellation], bases: dict[str, str]) -> None:
    for topic, listeners in topics.items():
        print(f"{clean(topic)}: zero velocity, {plural(listeners, 'listener')} on the hub")
    for base, reason in bases.items():
        print(f"{clean(base)}: {clean(reason) or 'stands still'}")
    for cancel in cancels:
        text = f"not cancelled: {clean(cancel.error)}" if cancel.error else f"{plural(cancel.found, 'goal')} cancelled"
        print(f"{clean(cancel.name)}: {text}")

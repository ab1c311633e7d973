"""``midspan halt``: every base stands still, every goal is cancelled."""

from __future__ import annotations

import argparse
import threading
import time
from typing import Any

from bridge.cli.calling import Caller
from bridge.cli.console import print_json
from bridge.cli.decode import Types
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.text import clean, plural
from bridge.hub.call import CallError
from bridge.hub.publisher import HubPublisher
from bridge.hub.qos import Qos
from bridge.messages.json import from_json

VELOCITIES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
CANCEL = "/_action/cancel_goal"

DEFAULT_SECONDS = 2.0
"""So long zero is repeated: a topic that only now crosses to a side is heard there within this time."""

_PERIOD = 0.05
_ALL: dict[str, Any] = {"goal_info": {}}
"""A `CancelGoal` request without id and stamp: all goals (action_msgs/srv/CancelGoal)."""


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "halt",
        help="zero velocity on every side, and all goals cancelled",
        description="Publishes zero on every topic of velocities that is on the hub (which crosses to every side as"
        " the rules say), has each BaseControl forget its commands, and the gateway and Midspan's planners their goals,"
        " and cancels every goal of every action. Whoever"
        " commands on after that is obeyed again: it is no emergency stop. Exit code 1 where something did not answer.",
        epilog="Example: midspan halt",
    )
    parser.add_argument(
        "--seconds", type=float, default=DEFAULT_SECONDS, help=f"repeat zero for so long (default {DEFAULT_SECONDS:g})"
    )
    parser.add_argument("--json", action="store_true", help="print what was halted as JSON")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Halt everything; 1 where something did not answer."""
    with open_client(args) as client:
        client.settle()
        types = Types(client)
        zeros = Zeros(client, types)
        cancels = [Cancelling(client, types, name) for name in actions(client)]
        zeros.put()
        bases: dict[str, bool] = {}
        asking = threading.Thread(target=lambda: bases.update(_halted(client)), daemon=True)
        asking.start()
        end = time.monotonic() + args.seconds
        never = threading.Event()
        while time.monotonic() < end:
            never.wait(_PERIOD)
            zeros.put()
        asking.join()  # it has a time limit of its own
        topics = {topic: zeros.listeners(topic) for topic in zeros.topics}
        zeros.close()
    goals = {cancel.name: cancel.found for cancel in cancels}
    failed = [cancel for cancel in cancels if cancel.error]
    if args.json:
        errors = {cancel.name: cancel.error for cancel in failed}
        print_json({"topics": topics, "goals": goals, "bases": bases, "errors": errors})
    else:
        _tell(topics, cancels, bases)
    if not (topics or goals or bases):
        raise CliError("nothing to halt: the hub has no topic of velocities, no action and no BaseControl")
    return 1 if failed or not all(bases.values()) else 0


def actions(client: Client) -> list[str]:
    """The names of the actions that are served on the hub."""
    return sorted({e.topic.removesuffix(CANCEL) for e in client.hub.graph.servers() if e.topic.endswith(CANCEL)})


class Zeros:
    """Publishes zero velocity on every topic of velocities that is on the hub.

    Attributes:
        topics: their names.
    """

    def __init__(self, client: Client, types: Types) -> None:
        graph = client.hub.graph
        self._graph = graph
        ends = [*graph.publishers(), *graph.subscriptions()]
        found = sorted({(e.topic, e.type_name, e.type_hash) for e in ends if e.type_name in VELOCITIES})
        self.topics = [topic for topic, _, _ in found]
        self._publishers: list[tuple[HubPublisher, bytes]] = []
        for topic, name, type_hash in found:
            publisher = client.hub.publisher(topic, name, type_hash, Qos(depth=1), priority="command")
            self._publishers.append((publisher, from_json(types.registry, name, {})))

    def put(self) -> None:
        """Publish once on each."""
        for publisher, zero in self._publishers:
            publisher.put(zero)

    def listeners(self, topic: str) -> int:
        """How many listen to a topic on the hub."""
        return len(self._graph.subscriptions(topic))

    def close(self) -> None:
        """Leave the topics."""
        for publisher, _ in self._publishers:
            publisher.close()


class Cancelling:
    """The cancellation of all goals of one action.

    Attributes:
        name: the action's.
        found: how many goals are being cancelled.
        error: why they are not; "" where they are.
    """

    def __init__(self, client: Client, types: Types, name: str) -> None:
        self.name, self.found, self.error = name, 0, "it has not answered"
        try:
            Caller(client, types, f"{name}{CANCEL}").call(_ALL, self._answered)
        except CliError as err:
            self.error = str(err)

    def _answered(self, reply: dict[str, Any] | CallError) -> None:
        if isinstance(reply, CallError):
            self.error = str(reply)
            return
        self.found, self.error = len(reply["goals_canceling"]), ""


def _halted(client: Client) -> dict[str, bool]:
    """Each BaseControl, and whether it stands."""
    return {f"{a.worker} of {a.daemon}": not a.error for a in client.ask("halt")}


def _tell(topics: dict[str, int], cancels: list[Cancelling], bases: dict[str, bool]) -> None:
    for topic, listeners in topics.items():
        print(f"{clean(topic)}: zero velocity, {plural(listeners, 'listener')} on the hub")
    for base, stands in bases.items():
        print(f"{clean(base)}: {'stands still' if stands else 'has not answered'}")
    for cancel in cancels:
        told = f"not cancelled: {clean(cancel.error)}" if cancel.error else f"{plural(cancel.found, 'goal')} cancelled"
        print(f"{clean(cancel.name)}: {told}")

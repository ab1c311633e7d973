"""Derives actionlib servers and clients from the master's state.

A server subscribes to ``goal`` and ``cancel`` and publishes ``status``, ``feedback`` and ``result`` below the action's
name; a client does the reverse (http://wiki.ros.org/actionlib/DetailedDescription).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from bridge.adapters.ros1.graph.probe import Facts
from bridge.adapters.ros1.graph.state import MasterState, Registration
from bridge.messages import actions as ros2_action

GOAL, CANCEL, STATUS, FEEDBACK, RESULT = "goal", "cancel", "status", "feedback", "result"

TO_SERVER = frozenset({GOAL, CANCEL})
FROM_SERVER = frozenset({STATUS, FEEDBACK, RESULT})

STATUS_TYPE = "actionlib_msgs/GoalStatusArray"
CANCEL_TYPE = "actionlib_msgs/GoalID"
STATUS_TYPE_ON_HUB = "action_msgs/GoalStatusArray"
_SUFFIXES = {GOAL: "ActionGoal", FEEDBACK: "ActionFeedback", RESULT: "ActionResult"}


@dataclass(frozen=True, slots=True)
class FoundServer:
    """An actionlib server: its action, type without suffix (``move_base_msgs/MoveBase``), node, XML-RPC address."""

    name: str
    type: str
    node: str
    uri: str

    def link(self, topic: str) -> Registration:
        """Return the server's registration for one of the five topics."""
        return Registration(self.node, f"{self.name}/{topic}", self.uri)


@dataclass(frozen=True, slots=True)
class FoundActions:
    """The servers of each action, ordered by node name, and the topics of actions with their types.

    ``topics`` also has the topics of actions that only have clients; none of these topics is bridged as a topic.
    """

    servers: Mapping[str, tuple[FoundServer, ...]]
    topics: Mapping[str, str]


NOTHING = FoundActions({}, {})


def topics_of(name: str, type_: str) -> dict[str, str]:
    """Return the five topics of an action with their types."""
    types = {part: f"{type_}{suffix}" for part, suffix in _SUFFIXES.items()}
    types |= {STATUS: STATUS_TYPE, CANCEL: CANCEL_TYPE}
    return {f"{name}/{part}": kind for part, kind in types.items()}


def find(state: MasterState, own: str) -> FoundActions:
    """Return the actions in a master's state, without the actions of the node ``own``."""
    published = _by_node(state.publishers, own)
    subscribed = _by_node(state.subscribers, own)
    servers: dict[str, list[FoundServer]] = defaultdict(list)
    topics: dict[str, str] = {}
    for ends, opposite in ((published, subscribed), (subscribed, published)):  # servers, then clients
        for (name, node, uri), parts in ends.items():
            if parts >= FROM_SERVER and opposite.get((name, node, uri), set()) >= TO_SERVER:
                type_ = _type(name, state.types)
                if not type_:
                    continue
                topics |= topics_of(name, type_)
                if ends is published:
                    servers[name].append(FoundServer(name, type_, node, uri))
    return FoundActions({n: tuple(sorted(s, key=lambda s: s.node)) for n, s in servers.items()}, topics)


def _by_node(links: Iterable[Registration], own: str) -> dict[tuple[str, str, str], set[str]]:
    """Return which of the five topics each node has, by action, node and address."""
    topics: dict[tuple[str, str, str], set[str]] = defaultdict(set)
    for node, topic, uri in links:
        name, _, part = topic.rpartition("/")
        if node != own and name and (part in FROM_SERVER or part in TO_SERVER):
            topics[name, node, uri].add(part)
    return topics


def _type(name: str, types: Mapping[str, str]) -> str:
    """Derive the action's type from its result topic's; return "" if a known type of the five topics does not fit."""
    result = types.get(f"{name}/{RESULT}", "")
    if not result.endswith(_SUFFIXES[RESULT]):
        return ""
    type_ = result.removesuffix(_SUFFIXES[RESULT])
    known = ((types.get(topic, ""), wanted) for topic, wanted in topics_of(name, type_).items())
    return type_ if all(listed in ("", "*", wanted) for listed, wanted in known) else ""


def is_native(server: FoundServer, facts: Mapping[Registration, Facts]) -> bool | None:
    """Return whether a server is native rather than Midspan's; None until it has responded."""
    known = [facts.get(server.link(part)) for part in FROM_SERVER]
    return None if None in known else all(f is not None and f.native for f in known)


def part_type(action_type: str, part: str) -> str:
    """Return the ROS 2 type of one part of an action; ``action_type`` is, for example, ``move_base_msgs/MoveBase``."""
    ending = ros2_action.ENDINGS.get(part)
    if ending is not None:
        return action_type.replace("/", "/action/", 1) + ending
    return STATUS_TYPE_ON_HUB if part == ros2_action.STATUS else ros2_action.CANCEL


def split_part(name: str, type_name: str) -> tuple[str, str] | None:
    """Return action and part of a service or topic, None if it is not part of an action."""
    action, part = ros2_action.split(name)
    ending = ros2_action.ENDINGS.get(part)
    fits = (
        type_name == part_type("", part) if ending is None else "/action/" in type_name and type_name.endswith(ending)
    )
    return (action, part) if part and fits else None


def action_type(type_name: str, part: str) -> str:
    """Return the action's type, given the type of its send_goal, get_result or feedback."""
    return type_name.removesuffix(ros2_action.ENDINGS[part]).replace("/action/", "/", 1)

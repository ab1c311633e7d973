"""Which actionlib servers and clients a look at the master shows.

A server subscribes ``goal`` and ``cancel`` and publishes ``status``, ``feedback`` and ``result`` below the action's
name; a client the reverse (http://wiki.ros.org/actionlib/DetailedDescription).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from bridge.adapters.ros1.graph import Link, Look
from bridge.adapters.ros1.probe import Facts

GOAL, CANCEL, STATUS, FEEDBACK, RESULT = "goal", "cancel", "status", "feedback", "result"

TO_SERVER = frozenset({GOAL, CANCEL})
FROM_SERVER = frozenset({STATUS, FEEDBACK, RESULT})

STATUS_TYPE = "actionlib_msgs/GoalStatusArray"
CANCEL_TYPE = "actionlib_msgs/GoalID"
_SUFFIXES = {GOAL: "ActionGoal", FEEDBACK: "ActionFeedback", RESULT: "ActionResult"}


@dataclass(frozen=True, slots=True)
class Server:
    """One actionlib server.

    Attributes:
        name: the action's.
        type: its type without ending: ``move_base_msgs/MoveBase`` has MoveBaseActionGoal and so on.
        node: the node's name.
        uri: its XML-RPC address.
    """

    name: str
    type: str
    node: str
    uri: str

    def link(self, topic: str) -> Link:
        """Its registration for one of the five topics."""
        return Link(self.node, f"{self.name}/{topic}", self.uri)


@dataclass(frozen=True, slots=True)
class Found:
    """What one look shows.

    Attributes:
        servers: those of each action, in the order of their nodes' names.
        topics: the topics of all actions, whether only clients or servers are there, and the types they must have;
            none of these crosses as a topic.
    """

    servers: Mapping[str, tuple[Server, ...]]
    topics: Mapping[str, str]


NOTHING = Found({}, {})


def topics_of(name: str, type_: str) -> dict[str, str]:
    """The five topics of an action with their types."""
    types = {part: f"{type_}{suffix}" for part, suffix in _SUFFIXES.items()}
    types |= {STATUS: STATUS_TYPE, CANCEL: CANCEL_TYPE}
    return {f"{name}/{part}": kind for part, kind in types.items()}


def find(look: Look, own: str) -> Found:
    """The actions of a look, without what our own node has."""
    published = _by_node(look.publishers, own)
    subscribed = _by_node(look.subscribers, own)
    servers: dict[str, list[Server]] = defaultdict(list)
    topics: dict[str, str] = {}
    for ends, others, has, hears in (
        (published, subscribed, FROM_SERVER, TO_SERVER),
        (subscribed, published, FROM_SERVER, TO_SERVER),
    ):
        for (name, node, uri), parts in ends.items():
            if has <= parts and hears <= others.get((name, node, uri), set()):
                type_ = _type(name, look.types)
                if not type_:
                    continue
                topics |= topics_of(name, type_)
                if ends is published:
                    servers[name].append(Server(name, type_, node, uri))
    return Found({n: tuple(sorted(s, key=lambda s: s.node)) for n, s in servers.items()}, topics)


def _by_node(links: Iterable[Link], own: str) -> dict[tuple[str, str, str], set[str]]:
    """Which of the five topics each node has, by action, node and address."""
    found: dict[tuple[str, str, str], set[str]] = defaultdict(set)
    for node, topic, uri in links:
        name, _, part = topic.rpartition("/")
        if node != own and name and (part in FROM_SERVER or part in TO_SERVER):
            found[name, node, uri].add(part)
    return found


def _type(name: str, types: Mapping[str, str]) -> str:
    """The action's type where all that is known of the five topics agrees, else ""."""
    result = types.get(f"{name}/{RESULT}", "")
    if not result.endswith(_SUFFIXES[RESULT]):
        return ""
    type_ = result.removesuffix(_SUFFIXES[RESULT])
    known = ((types.get(topic, ""), wanted) for topic, wanted in topics_of(name, type_).items())
    return type_ if all(is_ in ("", "*", wanted) for is_, wanted in known) else ""


def is_native(server: Server, facts: Mapping[Link, Facts]) -> bool | None:
    """Whether a server is no Midspan's; None while it has not answered."""
    found = [facts.get(server.link(part)) for part in FROM_SERVER]
    return None if None in found else all(f is not None and f.native for f in found)

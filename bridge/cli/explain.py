"""``midspan explain NAME``: why is this topic, service or action bridged, or why is it not?"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bridge.cli.console import print_json
from bridge.cli.doors import refusals
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.port_text import port_lines, port_list
from bridge.cli.routes_table import Document, arrow, drops_text, route_list
from bridge.cli.text import clean, duration, plural, rate, side_name
from bridge.cli.topic_info import endpoint_json, endpoint_text, unknown_topic
from bridge.cli.topic_view import Decision, absolute, ask_decisions, known_names
from bridge.doctor import hubtypes
from bridge.hub.graph import HubEndpoint
from bridge.routing.subject import split

_WORDS = {
    "bridged": "crosses",
    "denied": "does not cross",
    "private": "does not cross",
    "refused": "cannot cross",
    "unseen": "has nothing to cross",
    "own": "is not taken up",
    "standby": "is not carried here",
}


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "explain",
        help="say why a topic, service or action is or is not bridged",
        description="Asks every worker what it decided of a topic, service or action and why, adds what the hub itself"
        " shows, and says it in sentences, with the cure where something stands in the way. Exit code 1 where nobody"
        " knows it.",
    )
    parser.add_argument("topic", help="its name, on the hub or on a side; or that of a YARP port of ours")
    parser.add_argument("--json", action="store_true", help="print it as JSON")
    add_hub_arguments(parser)


@dataclass(frozen=True, slots=True)
class Note:
    """Something worth knowing about a topic, and what to do about it."""

    text: str
    cure: str = ""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Everything that is known of one topic.

    Attributes:
        decisions: what the workers decided, each with its route's status where there is one.
        endpoints: publishers and subscriptions on the hub.
        notes: what the hub's view and the workers' states add.
        ports: the YARP ports that carry it, as the workers' status documents have them.
    """

    topic: str
    decisions: Sequence[tuple[Decision, Document | None]]
    endpoints: Sequence[HubEndpoint]
    notes: Sequence[Note]
    ports: Sequence[Document] = ()


def run(args: argparse.Namespace) -> int:
    """Explain one topic."""
    with open_client(args) as client:
        explanation = explain(client, absolute(args.topic))
    if args.json:
        print_json(_as_json(explanation))
    else:
        print("\n".join(_sentences(explanation)))
    return 0


def explain(client: Client, topic: str) -> Explanation:
    """Gather what is known of a topic; raises `CliError` where nobody knows it."""
    decisions = _decisions(client, topic)
    documents = [a.value for a in client.ask("status") if isinstance(a.value, dict)]
    client.settle()
    names = {topic} | {d.hub_topic for d in decisions if d.decision == "bridged"}
    endpoints = [e for e in client.hub.graph.endpoints() if not e.own and names & {e.topic, split(e.topic)[0]}]
    endpoints.sort(key=lambda e: (e.topic, e.kind))
    ports = [
        port for document in documents for port in port_list(document) if names & {port.get("topic"), port.get("port")}
    ]
    if not decisions and not endpoints and not ports:
        raise CliError(unknown_topic(topic, known_names(client, documents)))
    paired = [(decision, _route(decision, documents)) for decision in decisions]
    names |= {d.topic for d in decisions}
    notes = [*_hub_notes(topic, endpoints), *_warnings(names, documents), *_worker_notes(decisions, documents)]
    notes += [Note(refusal.text, refusal.cure) for refusal in refusals(client, documents) if refusal.topic in names]
    return Explanation(topic, paired, endpoints, notes, ports)


def _decisions(client: Client, topic: str) -> list[Decision]:
    """What was decided of a topic; where it has another name on the hub, of what becomes of that too."""
    decisions = ask_decisions(client, topic, kind=None) or _of_action(client, topic)
    renamed = {d.hub_topic for d in decisions if d.decision == "bridged" and d.direction == "in"} - {topic}
    for name in sorted(renamed):
        decisions += [d for d in ask_decisions(client, name, kind=None) if d.direction == "out" and d not in decisions]
    return decisions


def _of_action(client: Client, name: str) -> list[Decision]:
    """What was decided of the parts of an action."""
    return [d for d in ask_decisions(client, "", kind=None) if name in (split(d.topic)[0], split(d.hub_topic)[0])]


def _route(decision: Decision, documents: Sequence[Document]) -> Document | None:
    if decision.decision != "bridged":
        return None
    for document in documents:
        if (document.get("daemon"), document.get("worker")) == (decision.daemon, decision.worker):
            for route in route_list(document):
                same = (route.get("direction"), route.get("topic")) == (decision.direction, decision.topic)
                if same and decision.type in (route.get("type"), route.get("side_type")):
                    return route
    return None


def _hub_notes(topic: str, endpoints: Sequence[HubEndpoint]) -> list[Note]:
    notes = [Note(conflict.text, conflict.cure) for conflict in hubtypes.conflicts(endpoints)]
    publishers = [e for e in endpoints if e.kind == "publisher"]
    subscriptions = [e for e in endpoints if e.kind == "subscription"]
    if subscriptions and not publishers:
        notes.append(Note(f"nobody publishes {topic} on the hub; {hubtypes.nodes(subscriptions)} would listen"))
    waiting = [e for e in publishers if e.pending]
    if waiting:
        notes.append(
            Note(f"it is not known yet which network {hubtypes.nodes(waiting)} speaks for, so nothing of it crosses")
        )
    if publishers and not any(p.qos.latched for p in publishers) and any(s.qos.latched for s in subscriptions):
        who = hubtypes.nodes(s for s in subscriptions if s.qos.latched)
        notes.append(
            Note(
                f"{who} asks for what was published before (transient local), but no publisher keeps it",
                "where the publisher cannot be changed, a rule with qos: {durability: transient_local} keeps its last"
                " message",
            )
        )
    return notes


def _warnings(names: set[str], documents: Sequence[Document]) -> list[Note]:
    """The workers' warnings that begin with the topic's name: QoS mismatches, types that nobody tells."""
    told = [
        (side_name(document.get("side")), str(warning))
        for document in documents
        if isinstance(document.get("warnings"), list)
        for warning in document["warnings"]
    ]
    return [Note(f"{side}: {text}") for side, text in told if text.partition(": ")[0] in names]


def _worker_notes(decisions: Sequence[Decision], documents: Sequence[Document]) -> list[Note]:
    if not documents:
        return [Note("no worker answers, so nothing is bridged now", "start the daemon: midspan run")]
    notes: list[Note] = []
    told = {(d.daemon, d.worker) for d in decisions}
    for document in documents:
        if document.get("module"):
            continue  # it decides of no topic
        side, who = document.get("side"), (document.get("daemon"), document.get("worker"))
        name = f"{side_name(side)} (daemon {clean(who[0])})"
        if document.get("state") == "waiting":
            notes.append(Note(f"{name} is away: nothing crosses to or from it now"))
        elif document.get("state") == "standby":
            notes.append(Note(f"{name} stands by: another daemon is active on that network"))
        elif side != "router" and who not in told:
            notes.append(Note(f"{name} has decided nothing of it: it is not published there, and nothing leads there"))
    return notes


def _sentences(explanation: Explanation) -> list[str]:
    lines: list[str] = []
    several = len({decision.daemon for decision, _ in explanation.decisions}) > 1
    for decision, route in explanation.decisions:
        whose = f" (daemon {decision.daemon})" if several else ""
        lines += _decision_lines(decision, route, whose)
    lines += _hub_lines(explanation)
    for port in explanation.ports:
        lines += port_lines(port)
    for note in explanation.notes:
        lines.append(f"Note: {clean(note.text)}.")
        if note.cure:
            lines.append(f"    cure: {clean(note.cure)}")
    return lines


_KINDS = {
    "publisher": "published by",
    "subscription": "heard by",
    "server": "served by",
    "client": "called by",
}


def _hub_lines(explanation: Explanation) -> list[str]:
    """Who has it on the hub."""
    ends = explanation.endpoints
    kinds = ("server", "client") if any(e.kind in ("server", "client") for e in ends) else ("publisher", "subscription")
    counts = [plural(sum(1 for e in ends if e.kind == kind), kind) for kind in kinds]
    lines = [f"On the hub: {', '.join(counts)}."]
    for e in ends:
        part = f" ({e.topic})" if e.topic != explanation.topic else ""
        lines.append(f"    {_KINDS[e.kind]} {endpoint_text(e)}{clean(part)}")
    return lines


def _decision_lines(decision: Decision, route: Document | None, whose: str) -> list[str]:
    word = _WORDS.get(decision.decision, decision.decision)
    name = decision.topic if decision.direction == "in" else decision.hub_topic
    lands = decision.hub_topic if decision.direction == "in" else decision.topic
    renamed = f" as {lands}" if decision.decision == "bridged" and name != lands else ""
    way = arrow(decision.worker, decision.direction)
    text = f"{way}{whose}: {name} ({decision.type}) {word}{renamed}: {decision.why}."
    lines = [clean(text)]
    if decision.cure:
        lines.append(f"    cure: {clean(decision.cure)}")
    if route is not None:
        lines.append(f"    {_flow(route)}")
        if route.get("error"):
            lines.append(f"    last error: {clean(route['error'])}")
    return lines


def _flow(route: Document) -> str:
    if route.get("kind") == "service":
        return _calls(route)
    if not route.get("messages"):
        return f"no message has come yet; drops: {drops_text(route)}"
    speed = rate(route.get("rate"))
    speed = "none in the last second" if speed == "-" else f"{speed} msg/s"
    return (
        f"{plural(route['messages'], 'message')}, {speed}, the last one {duration(route.get('age'))} ago;"
        f" drops: {drops_text(route)}; {clean(route.get('qos', ''))}"
    )


def _as_json(explanation: Explanation) -> dict[str, Any]:
    return {
        "topic": explanation.topic,
        "decisions": [{**decision.as_dict(), "route": route} for decision, route in explanation.decisions],
        "hub": [endpoint_json(endpoint) for endpoint in explanation.endpoints],
        "ports": list(explanation.ports),
        "notes": [dataclasses.asdict(note) for note in explanation.notes],
    }


def _calls(route: Document) -> str:
    if not route.get("messages"):
        return "nobody has called yet"
    under_way = f", {route['pending']} under way" if route.get("pending") else ""
    return (
        f"{plural(route['messages'], 'call')}, the last one {duration(route.get('age'))} ago: {route.get('replies', 0)}"
        f" replies, {route.get('errors', 0)} errors, {route.get('abandoned', 0)} given up by their callers{under_way}"
    )

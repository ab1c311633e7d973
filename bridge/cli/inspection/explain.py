"""``midspan explain NAME``: why a topic, service or action is bridged, or why it is not."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from bridge.cli.arguments import add_hub_arguments
from bridge.cli.client import client_config, of_this_machine, open_client
from bridge.cli.output import CliError, print_json
from bridge.client.graph import (
    Decision,
    absolute,
    decisions_in,
    endpoint_json,
    endpoint_text,
    known_names,
    owners,
    unknown,
)
from bridge.client.refusals import refusals
from bridge.client.session import ASK_SECONDS, Client
from bridge.client.status import daemon_names, documents_in, silent_workers
from bridge.config.model import Config
from bridge.config.rules import CommandRule
from bridge.config.sections.routing import Rule
from bridge.display.documents import connection_line, drops_text, port_lines, transport_text
from bridge.doctor import hub_problems
from bridge.doctor.hub_problems import Note, absence
from bridge.doctor.relayed import relay_texts, relayed_keys
from bridge.hub.control import WorkerAnswer
from bridge.hub.graph import HubEndpoint
from bridge.messages.actions import split
from bridge.routing.rules import ENTRY, RuleSet
from bridge.status import ConnectionStatus, PortStatus, RouteStatus, StatusDocument, read_connections
from bridge.text import arrow, clean, duration, plural, rate, side_name

_VERDICTS = {
    "bridged": "is bridged",
    "denied": "is not bridged",
    "private": "is not bridged",
    "refused": "cannot be bridged",
    "unseen": "has no endpoint to bridge",
    "own": "is not routed",
    "standby": "is not bridged here",
}


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Shows each worker's decision on a topic, service or action with the reason, the endpoints on the hub, and a"
        " cure for each problem. The exit code is 1 if the name is unknown."
    )
    parser.add_argument("topic", help="name on the hub or on a side, or the name of one of Midspan's YARP ports")
    parser.add_argument("--json", action="store_true", help="print the explanation as JSON")
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


@dataclass(frozen=True, slots=True)
class Explanation:
    """The decisions on one topic with their routes' status, and the topic's endpoints, notes, ports and connections."""

    topic: str
    decisions: Sequence[tuple[Decision, RouteStatus | None]]
    endpoints: Sequence[HubEndpoint]
    notes: Sequence[Note]
    ports: Sequence[PortStatus] = ()
    connections: Sequence[tuple[WorkerAnswer, ConnectionStatus]] = ()


def run(args: argparse.Namespace) -> int:
    config = client_config(args, partly=of_this_machine(args))
    with open_client(args, config=config) as client:
        explanation = explain(client, absolute(args.topic))
    if args.json:
        print_json(_as_json(explanation))
    else:
        print("\n".join(_sentences(explanation)))
    return 0


def explain(client: Client, topic: str) -> Explanation:
    """Gather the decisions, endpoints and problems of a topic; raises `CliError` if the name is unknown."""
    answers, documents, namesakes, connected = _query_hub(client)
    everything = decisions_in(answers)
    decisions = _decisions(everything, topic)
    names = {topic} | {d.hub_topic for d in decisions if d.decision == "bridged"}
    endpoints = [e for e in client.endpoints() if names & {e.topic, split(e.topic)[0]}]
    endpoints.sort(key=lambda e: (e.topic, e.kind))
    ports = [port for document in documents for port in document.ports if names & {port.topic, port.port}]
    missing_planner = planner_note(client.config, topic, client.endpoints(), documents)
    planner = [] if missing_planner is None else [missing_planner]
    silent = _silent_workers(client, documents)
    if not decisions and not endpoints and not ports:
        ruled = [Note(text) for text in by_rules(client.config, topic)]
        if not ruled:
            missing = "".join(f"\n{note.text}." for note in silent)
            raise CliError(unknown("topic", topic, known_names(client, documents, everything)) + missing)
        return Explanation(topic, (), (), [Note(f"no endpoint has the name {topic} now"), *planner, *ruled, *silent])
    paired = [(decision, _route(decision, documents)) for decision in decisions]
    names |= {d.topic for d in decisions}
    connections = _connections(connected, names)
    notes = [*silent, *_hub_notes(client, topic, endpoints, documents), *_warnings(names, documents)]
    if decisions or endpoints:  # no worker decides on a port, such as a module's
        notes += _worker_notes(decisions, documents, {(answer.daemon, answer.worker) for answer in answers})
    notes += [Note(refusal.text, refusal.cure) for refusal in refusals(client, documents) if refusal.topic in names]
    return Explanation(topic, paired, endpoints, [*planner, *notes, *namesakes], ports, connections)


def _query_hub(client: Client) -> tuple[list[WorkerAnswer], list[StatusDocument], list[Note], list[WorkerAnswer]]:
    """Return the sides' decisions, all status documents, notes on daemons with equal names, and sides' connections.

    The three queries run in parallel, because a hung worker delays each of them.
    """
    with ThreadPoolExecutor(3) as pool:
        decisions = pool.submit(client.ask, "explain", {"topic": ""})
        status = pool.submit(client.ask, "status")
        connections = pool.submit(client.ask, "connections")
        client.settle()
        names = daemon_names(client, status.result())
        documents, namesakes = documents_in(names.apply(status.result())), _namesakes(names.several())
        return names.apply(decisions.result()), documents, namesakes, names.apply(connections.result())


def _namesakes(several: Mapping[str, Sequence[str]]) -> list[Note]:
    return [
        Note(
            f"{len(places)} daemons on this hub are named {name!r}: {'; '.join(places)}",
            "set another 'name' in the configuration of one of them",
        )
        for name, places in several.items()
    ]


def _decisions(everything: Sequence[Decision], topic: str) -> list[Decision]:
    """Return the decisions on a topic; if it has another name on the hub, also those from that name to the sides."""

    def known_as(name: str) -> list[Decision]:
        return [d for d in everything if any(name in (known, split(known)[0]) for known in (d.topic, d.hub_topic))]

    decisions = known_as(topic)
    renamed = {d.hub_topic for d in decisions if d.decision == "bridged" and d.direction == "in"} - {topic}
    for name in sorted(renamed):
        decisions += [d for d in known_as(name) if d.direction == "out" and d not in decisions]
    return decisions


def _connections(answers: Sequence[WorkerAnswer], names: set[str]) -> list[tuple[WorkerAnswer, ConnectionStatus]]:
    """Return the connections of topics with one of the names, including the topics of a ROS 1 action."""
    actions = {split(name)[0] for name in names if split(name)[1]}
    return [
        (answer, connection)
        for answer in answers
        for connection in read_connections(answer.value)
        if connection.topic in names or connection.topic.rpartition("/")[0] in actions
    ]


def _silent_workers(client: Client, documents: Sequence[StatusDocument]) -> list[Note]:
    """Return notes on the workers that are on the hub but did not answer: their decisions are missing."""
    late = f"did not answer within {ASK_SECONDS:g} s, so its decisions are missing"
    return [
        Note(f"{side_name(origin.side)} (daemon {clean(origin.daemon)}) {late}", "see `midspan status`")
        for origin in silent_workers(client, documents)
    ]


def _route(decision: Decision, documents: Sequence[StatusDocument]) -> RouteStatus | None:
    if decision.decision != "bridged":
        return None
    for document in documents:
        if (document.daemon, document.worker) == (decision.daemon, decision.worker):
            for route in document.routes:
                same = (route.direction, route.topic) == (decision.direction, decision.topic)
                if same and decision.type in (route.type, route.side_type):
                    return route
    return None


def _hub_notes(
    client: Client, topic: str, endpoints: Sequence[HubEndpoint], documents: Sequence[StatusDocument]
) -> list[Note]:
    workers, relayed = {zid for document in documents for zid in document.hub_sessions}, relayed_keys(documents)
    notes = [Note(text) for text in relay_texts(documents, {endpoint.topic for endpoint in endpoints})]
    notes += hub_problems.conflicts(endpoints, workers, lambda: client.registry().releases, relayed)
    notes += hub_problems.separated(endpoints, workers, relayed)
    publishers = [e for e in endpoints if e.kind == "publisher"]
    subscriptions = [e for e in endpoints if e.kind == "subscription"]
    if subscriptions and not publishers:
        notes.append(Note(f"{topic} has no publisher on the hub; subscribed by {owners(subscriptions)}"))
    waiting = [e for e in publishers if e.pending]
    if waiting:
        who = owners(waiting)
        notes.append(Note(f"the network of {who} is not known yet, so no messages from there are bridged"))
    if publishers and not any(p.qos.latched for p in publishers) and any(s.qos.latched for s in subscriptions):
        who = owners(s for s in subscriptions if s.qos.latched)
        text = f"{who} requests earlier messages (transient local), but no publisher stores them"
        cure = (
            "if the publisher cannot be changed, a rule with qos: {durability: transient_local} stores its last message"
        )
        notes.append(Note(text, cure))
    return notes


def _warnings(names: set[str], documents: Sequence[StatusDocument]) -> list[Note]:
    """Return the workers' warnings that begin with the topic's name: QoS mismatches, types without a definition."""
    return [
        Note(f"{side_name(document.side)}: {warning}")
        for document in documents
        for warning in document.warnings
        if warning.partition(": ")[0] in names
    ]


def _worker_notes(
    decisions: Sequence[Decision], documents: Sequence[StatusDocument], sides: Collection[tuple[str, str]]
) -> list[Note]:
    """Return notes on the sides that are unavailable, on standby or without a decision.

    ``sides`` has the daemon and the worker of every side that answered.
    """
    if not documents:
        return [Note("no worker answers, so nothing is bridged now", "start the daemon: midspan run")]
    notes: list[Note] = []
    decided = {(d.daemon, d.worker) for d in decisions}
    for document in documents:
        who = (document.daemon, document.worker)
        if who not in sides:
            continue  # a module, the router, the console: they decide on no topic
        name = f"{side_name(document.side or who[1])} (daemon {clean(who[0])})"
        if document.state == "waiting":
            notes.append(Note(f"{name} is unavailable: nothing is bridged to or from it now"))
        elif document.state == "standby":
            notes.append(Note(f"{name} is on standby: another daemon is active on that network"))
        elif who not in decided:
            notes.append(Note(f"{name} has no decision on it, as the name is neither published there nor sent there"))
    return notes


def _sentences(explanation: Explanation) -> list[str]:
    lines: list[str] = []
    several = len({decision.daemon for decision, _ in explanation.decisions}) > 1
    for decision, route in explanation.decisions:
        whose = f" (daemon {decision.daemon})" if several else ""
        lines += _decision_lines(decision, route, whose)
    if explanation.decisions or explanation.endpoints:
        lines += _hub_lines(explanation)
    for port in explanation.ports:
        lines += port_lines(port)
    for answer, connection in explanation.connections:
        whose = f" (daemon {answer.daemon})" if several else ""
        lines.append(clean(connection_line(answer.worker, whose, connection)))
    for note in explanation.notes:
        lines.append(f"Note: {clean(note.text)}.")
        if note.cure:
            lines.append(f"    cure: {clean(note.cure)}")
    return lines


_KINDS = {"publisher": "published by", "subscription": "subscribed by", "server": "served by", "client": "called by"}


def _hub_lines(explanation: Explanation) -> list[str]:
    ends = explanation.endpoints
    kinds = ("server", "client") if any(e.kind in ("server", "client") for e in ends) else ("publisher", "subscription")
    counts = [plural(sum(1 for e in ends if e.kind == kind), kind) for kind in kinds]
    lines = [f"On the hub: {', '.join(counts)}."]
    for e in ends:
        part = f" ({e.topic})" if e.topic != explanation.topic else ""
        lines.append(f"    {_KINDS[e.kind]} {endpoint_text(e)}{clean(part)}")
    return lines


def _decision_lines(decision: Decision, route: RouteStatus | None, whose: str) -> list[str]:
    verdict = _VERDICTS.get(decision.decision, decision.decision)
    name = decision.topic if decision.direction == "in" else decision.hub_topic
    target = decision.hub_topic if decision.direction == "in" else decision.topic
    renamed = f" as {target}" if decision.decision == "bridged" and name != target else ""
    sides = arrow(decision.worker, decision.direction)
    text = f"{sides}{whose}: {name} ({decision.type}) {verdict}{renamed}: {decision.why}."
    lines = [clean(text)]
    if decision.cure:
        lines.append(f"    cure: {clean(decision.cure)}")
    lines += [f"    {clean(users)}" for users in decision.users]
    if route is not None:
        lines.append(f"    {_traffic(route)}")
        if route.error:
            lines.append(f"    last error: {clean(route.error)}")
    return lines


def _traffic(route: RouteStatus) -> str:
    if route.kind == "service":
        return _calls(route)
    transport = f"; {transport_text(route)}" if transport_text(route) else ""
    if not route.messages:
        return f"no message yet; drops: {drops_text(route)}{transport}"
    speed = rate(route.rate)
    speed = "none in the last second" if speed == "-" else f"{speed} msg/s"
    return (
        f"{plural(route.messages, 'message')}, {speed}, the last one {duration(route.age)} ago;"
        f" drops: {drops_text(route)}; {clean(route.qos)}{transport}"
    )


def _as_json(explanation: Explanation) -> dict[str, Any]:
    return {
        "topic": explanation.topic,
        "decisions": [
            {**decision.as_dict(), "route": route.document() if route is not None else None}
            for decision, route in explanation.decisions
        ],
        "hub": [endpoint_json(endpoint) for endpoint in explanation.endpoints],
        "ports": [port.document() for port in explanation.ports],
        "connections": [
            {"daemon": answer.daemon, "worker": answer.worker, **connection.document()}
            for answer, connection in explanation.connections
        ],
        "notes": [dataclasses.asdict(note) for note in explanation.notes],
    }


def _calls(route: RouteStatus) -> str:
    if not route.messages:
        return "no call yet"
    pending = f", {route.pending} pending" if route.pending else ""
    return (
        f"{plural(route.messages, 'call')}, the last one {duration(route.age)} ago: {route.replies or 0}"
        f" replies, {route.errors or 0} errors, {route.abandoned or 0} abandoned by their clients{pending}"
    )


_EVERYTHING = (None, "**", "/**")


def planner_note(
    config: Config, name: str, endpoints: Iterable[HubEndpoint], documents: Sequence[StatusDocument]
) -> Note | None:
    """Return why the configured planner is missing if ``name`` is its action, on its side or the hub; else None."""
    section = config.navigation
    other = section.others.get(section.planner)
    if not section.planner or name not in (section.at(section.planner), other and other.action):
        return None
    return absence(section, section.planner, endpoints, documents)


def by_rules(config: Config, name: str) -> Iterator[str]:
    """Yield a sentence for each rule that matches ``name`` or renames something to it, except rules for all names."""
    rules = list(RuleSet(config.rules).naming(name))
    denying = [of for of, rule, matches in rules if matches and _denies_all(rule)]
    for of, rule, matches in rules:
        if matches and (rule.regex or rule.topic not in _EVERYTHING):
            effect = f"is not bridged, because {denying[0]} denies it" if denying and not rule.deny else _effect(rule)
            yield f"{of}: {_subject(rule)} with this name {effect}"
        elif rule.rename == name:
            yield f"{of}: {_subject(rule)} {rule.topic or rule.regex} gets this name"


def _denies_all(rule: Rule) -> bool:
    """Return whether a rule keeps all that its pattern matches off the hub, of any kind, side and type."""
    return rule.deny and rule.to in (None, ENTRY) and (rule.kind, rule.from_, rule.type) == (None, None, None)


def _subject(rule: Rule) -> str:
    kind = {None: "a topic, service or action", "action": "an action"}.get(rule.kind, f"a {rule.kind}")
    typed = "" if rule.type is None else f" ({rule.type})"
    return f"{kind}{typed}" + ("" if rule.from_ is None else f" of {side_name(rule.from_)}")


def _effect(rule: Rule) -> str:
    if isinstance(rule, CommandRule):
        return "carries commands, which move the robot"
    destination = "" if rule.to is None else " into the hub" if rule.to == "zenoh" else f" to {side_name(rule.to)}"
    if rule.deny:
        return f"is not bridged{destination}"
    return f"is bridged{destination}" + ("" if rule.rename is None else f" as {rule.rename}")

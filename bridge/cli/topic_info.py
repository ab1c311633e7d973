"""``midspan topic info``: one topic with its endpoints on the hub and what the workers decided of it."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli.console import print_json
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, add_hub_arguments, open_client
from bridge.cli.text import clean, near, side_name
from bridge.cli.topic_view import TopicView, absolute, all_topics
from bridge.hub.graph import HubEndpoint
from bridge.routing.route import qos_text


def register(subparsers: Any) -> None:
    """Add the verb's parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "info",
        help="one topic: types, publishers, subscriptions, QoS",
        description="Shows a topic's types, and each publisher and subscription that it has on the hub, with its"
        " quality of service and the side that it speaks for.",
    )
    parser.add_argument("topic", help="the topic's name")
    parser.add_argument("--json", action="store_true", help="print it as JSON")
    add_hub_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Show one topic."""
    name = absolute(args.topic)
    with open_client(args) as client:
        view = find(client, name)
    if args.json:
        print_json(_as_json(view))
    else:
        _show(view)
    return 0


def find(client: Client, name: str) -> TopicView:
    """What is known of a topic by its name on the hub or on a side; raises `CliError` where nothing is."""
    views = all_topics(client)
    if name in views:
        return views[name]
    for view in views.values():
        if any(name in (d.topic, d.hub_topic) for d in view.decisions):
            return view
    raise CliError(unknown_topic(name, views))


def unknown_topic(name: str, names: Any) -> str:
    """The words for a topic that nobody knows, with the names that may have been meant."""
    meant = near(name, names)
    hint = f" Did you mean {', '.join(meant)}?" if meant else " 'midspan topic list' shows all."
    return f"no topic {name} on the hub or on any side.{hint}"


def endpoint_text(endpoint: HubEndpoint) -> str:
    """One endpoint for people."""
    name = f"{endpoint.namespace.rstrip('/')}/{endpoint.node}"
    if endpoint.origin is None:
        who = "maker not known yet" if endpoint.pending else "zenoh, on the hub itself"
    else:
        who = f"for {side_name(endpoint.origin.side)}, daemon {endpoint.origin.daemon}"
    return f"{clean(name)} ({clean(who)}), {qos_text(endpoint.qos)}, {clean(endpoint.type_name)}"


def endpoint_json(endpoint: HubEndpoint) -> dict[str, Any]:
    """One endpoint as JSON."""
    origin = endpoint.origin
    return {
        "node": f"{endpoint.namespace.rstrip('/')}/{endpoint.node}",
        "kind": str(endpoint.kind),
        "type": endpoint.type_name,
        "hash": endpoint.type_hash,
        "qos": qos_text(endpoint.qos),
        "gid": endpoint.gid.hex(),
        "zid": endpoint.zid,
        "side": "zenoh" if origin is None else origin.side,
        "network": None if origin is None else origin.network,
        "daemon": None if origin is None else origin.daemon,
    }


def _show(view: TopicView) -> None:
    print(f"topic: {clean(view.name)}")
    print(f"type: {clean(', '.join(sorted(view.types)))}")
    for title, endpoints in (("publishers", view.publishers), ("subscriptions", view.subscriptions)):
        print(f"{title} on the hub: {len(endpoints)}")
        for endpoint in endpoints:
            print(f"  {endpoint_text(endpoint)}")
    if view.decisions:
        print("decisions:")
        for d in view.decisions:
            way = f"{side_name(d.worker)} -> hub" if d.direction == "in" else f"hub -> {side_name(d.worker)}"
            print(f"  {way}: {clean(d.decision)}: {clean(d.why)}")


def _as_json(view: TopicView) -> dict[str, Any]:
    return {
        "topic": view.name,
        "types": sorted(view.types),
        "publishers": [endpoint_json(endpoint) for endpoint in view.publishers],
        "subscriptions": [endpoint_json(endpoint) for endpoint in view.subscriptions],
        "decisions": [decision.as_dict() for decision in view.decisions],
    }

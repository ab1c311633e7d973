"""``midspan service``: list, info and call on any service, whichever side it is served on."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli.call_list import register_info, register_list, run_info, run_list
from bridge.cli.call_view import all_services
from bridge.cli.calling import Caller, spelled, type_and_values
from bridge.cli.console import print_json
from bridge.cli.decode import Types
from bridge.cli.hubclient import add_hub_arguments, open_client
from bridge.cli.topic_pub import yaml_fields
from bridge.cli.topic_view import absolute
from bridge.cli.yaml_text import message_text


def register(subparsers: Any) -> None:
    """Add the verb's parser, and one for each of its own verbs."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "service",
        help="list, info and call on any side's services",
        description="Looks at services and calls them, whichever side they are served on.",
    )
    verbs = parser.add_subparsers(dest="service_verb", metavar="VERB", required=True)
    register_list(verbs, "service")
    register_info(verbs, "service")
    call: argparse.ArgumentParser = verbs.add_parser(
        "call",
        help="call a service",
        description="Calls a service once and prints its reply. The request is checked against its type; fields that"
        " are left out are zero or empty. Without a server it waits 5 s for one. Exit code 1 where the call failed.",
        epilog="Example: midspan service call /static_map --timeout 10",
    )
    call.add_argument("name", help="the service's name")
    call.add_argument(
        "request", nargs="*", metavar="[TYPE] REQUEST", help="the fields as YAML or JSON, for example '{data: true}'"
    )
    call.add_argument("--timeout", type=float, metavar="SECONDS", help="give up after so long (default: never)")
    call.add_argument("--full", action="store_true", help="print long arrays and texts whole")
    call.add_argument("--json", action="store_true", help="print the reply as JSON")
    add_hub_arguments(call)


def run(args: argparse.Namespace) -> int:
    """Run one of the service verbs."""
    if args.service_verb == "list":
        return run_list(args, all_services, "service")
    if args.service_verb == "info":
        return run_info(args, all_services, "service")
    return _call(args)


def _call(args: argparse.Namespace) -> int:
    type_name, values = type_and_values(args.request)
    request = yaml_fields(values)
    with open_client(args) as client:
        caller = Caller(client, Types(client), absolute(args.name), spelled(type_name, "srv"))
        reply = caller.ask(request, args.timeout)
    if args.json:
        print_json(reply)
    else:
        print(message_text(reply, full=args.full) if reply else "done", end="" if reply else "\n")
    return 0

"""``midspan nav startup``, ``shutdown`` and similar: commands for a planner's lifecycle managers, such as Nav2's."""

from __future__ import annotations

import argparse
from typing import Any

from bridge.cli.arguments import add_verb, seconds
from bridge.cli.client import CliClient, open_client
from bridge.cli.navigation.gateway import no_answer
from bridge.cli.output import CliError
from bridge.client.errors import ClientError
from bridge.client.navigation import STATUS_TOPIC, gateway_document
from bridge.client.services import ServiceCaller
from bridge.client.types import Types
from bridge.config.sections.navigation import NavigationSection, Planner
from bridge.module_keys import GatewayKeys
from bridge.text import clean
from navigation.status import State, has_ended

MANAGE, TRIGGER = "nav2_msgs/srv/ManageLifecycleNodes", "std_srvs/srv/Trigger"
_STARTUP, _DEACTIVATE, _ACTIVATE, _RESET, _SHUTDOWN = "startup", "deactivate", "activate", "reset", "shutdown"
COMMANDS = {_STARTUP: 0, _DEACTIVATE: 1, _ACTIVATE: 2, _RESET: 3, _SHUTDOWN: 4}
"""Constants of `ManageLifecycleNodes.srv`; Nav2 names 1 and 2 PAUSE and RESUME, which are other commands here."""

_DONE = {
    _STARTUP: "all its nodes are active",
    _DEACTIVATE: "all its nodes are inactive",
    _ACTIVATE: "all its nodes are active",
    _RESET: "all its nodes are unconfigured",
    _SHUTDOWN: "all its nodes are shut down",
}
_ANSWER_SECONDS = 60.0
_ACTIVE_SECONDS = 5.0


def add_lifecycle_verbs(verbs: Any) -> None:
    """Add the commands below ``midspan nav``."""
    for verb, text in (
        (_STARTUP, "configure and activate the planner's nodes (Nav2); the robot does not move"),
        (_DEACTIVATE, "deactivate the planner's nodes; they stay configured"),
        (_ACTIVATE, "activate the planner's nodes again"),
        (_RESET, "deactivate and clean up the planner's nodes, after which startup configures them again"),
        (_SHUTDOWN, "shut the planner's nodes down; to start again they need their launch file"),
    ):
        added = add_verb(verbs, verb, run, text, example=f"midspan nav {verb}")
        added.add_argument(
            "--timeout",
            type=seconds,
            default=_ANSWER_SECONDS,
            metavar="SECONDS",
            help=f"wait for each lifecycle manager this long (default {_ANSWER_SECONDS:g})",
        )


def run(args: argparse.Namespace) -> int:
    """Command each lifecycle manager of the planner that is on the hub."""
    verb: str = args.nav_verb
    with open_client(args) as client:
        client.settle()
        planner = _planner(client)
        managers = [name for name in planner.managers if client.servers(f"{name}/manage_nodes")]
        if not managers:
            raise CliError(_manager_missing(planner))
        types = Types(client)
        for manager in managers if verb in (_STARTUP, _ACTIVATE) else reversed(managers):
            _command(client, types, manager, verb, args.timeout)
    return 0


def _planner(client: CliClient) -> Planner:
    """Return the planner in use; raises `CliError` if it has no lifecycle managers, or is not known to be idle."""
    section: NavigationSection = client.config.navigation
    gateway: GatewayKeys | None = None
    try:
        gateway = gateway_document(client).other(GatewayKeys)
    except ClientError:
        if client.publishers(STATUS_TOPIC):
            raise CliError(no_answer(client)) from None
        # without a gateway, no part of Midspan drives the robot
    name = (gateway.planner if gateway is not None else "") or section.planner or "nav2"
    planner = section.other(name)
    if planner is None or not planner.managers:
        raise CliError(
            f"{clean(name)} has no lifecycle managers: choose a planner such as nav2, or name them in"
            " 'lifecycle_managers' of its entry in navigation.planners"
        )
    if gateway is not None and not _is_idle(gateway):
        raise CliError(f"{clean(name)} has a goal, or the robot may be moving: stop it first ('midspan nav stop')")
    return planner


def _is_idle(gateway: GatewayKeys) -> bool:
    """Return whether no goal is active; THINKING means that the planner is unavailable, as before a startup."""
    ended = has_ended(gateway.navigation) or gateway.navigation == State.THINKING
    return ended and not (gateway.goals or gateway.goals_of_others)


def _manager_missing(planner: Planner) -> str:
    services = " or ".join(f"{name}/manage_nodes" for name in planner.managers)
    return (
        f"no lifecycle manager is on the hub: {services} has no server. Start {planner.name} (for Nav2: its launch"
        " file), or name its managers in 'lifecycle_managers' of its entry in navigation.planners;"
        f" 'midspan explain {planner.managers[0]}/manage_nodes' shows why one that runs is missing"
    )


def _command(client: CliClient, types: Types, manager: str, verb: str, seconds: float) -> None:
    if verb == _STARTUP and _is_active(client, types, manager):  # nodes that are active cannot be configured
        print(f"{clean(manager)}: all its nodes are already active")
        return
    caller = ServiceCaller(client, types, f"{manager}/manage_nodes", MANAGE)
    try:
        reply = caller.ask({"command": COMMANDS[verb]}, seconds)
    except ClientError as err:
        raise CliError(
            f"{err}; the transition may still continue: 'midspan nav status' shows the nodes' states"
        ) from None
    finally:
        caller.close()
    if not reply["success"]:
        raise CliError(
            f"{clean(manager)}: {verb} failed; 'midspan nav status' shows the nodes' states with the cure, and the log"
            " of the manager shows the reason"
        )
    print(f"{clean(manager)}: {_DONE[verb]}")


def _is_active(client: CliClient, types: Types, manager: str) -> bool:
    name = f"{manager}/is_active"
    if not client.servers(name):
        return False
    caller = ServiceCaller(client, types, name, TRIGGER)
    try:
        return bool(caller.ask({}, _ACTIVE_SECONDS)["success"])
    finally:
        caller.close()

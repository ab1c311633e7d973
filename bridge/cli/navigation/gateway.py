"""The gateway's state and services, for commands."""

from __future__ import annotations

from typing import Any

from bridge.cli.client import CliClient
from bridge.cli.output import CliError
from bridge.client.errors import ClientError
from bridge.client.navigation import STATUS_TOPIC, Navigation, gateway_document
from bridge.client.services import ServiceCaller
from bridge.client.status import documents_in
from bridge.client.types import Types
from bridge.doctor.hub_problems import Note, absence, inactive_nodes
from bridge.module_keys import GatewayKeys
from bridge.status import StatusDocument

NO_GATEWAY = "no gateway is configured: name a planner in the section 'navigation' of the configuration"
_LATE = (
    "the gateway's worker runs, but the gateway does not answer: the machine is busy, or the gateway hangs; ask again,"
    " and see 'midspan status'"
)
_WORKER = "modules"


def gateway_status(client: CliClient) -> StatusDocument:
    """Return the gateway's status document; raises `CliError` without a gateway, or if it does not answer."""
    try:
        return gateway_document(client)
    except ClientError:
        raise CliError(no_answer(client)) from None


def check_daemon(client: CliClient) -> None:
    """Raise `CliError` if the daemon is down and no other daemon has a gateway: waiting would be useless."""
    state = client.daemon()
    if state.trouble:
        client.settle()
        if not client.publishers(STATUS_TOPIC):
            raise CliError(f"no gateway answers: {state.trouble}")


def no_answer(client: CliClient) -> str:
    """Return why no gateway answers: the daemon is down, no gateway is configured or runs, or it is too slow."""
    documents = documents_in(client.ask("status"))
    state = client.daemon(documents)
    if state.trouble:
        return state.trouble
    client.settle()
    published = bool(client.publishers(STATUS_TOPIC))
    if not client.config.navigation.planner:
        return _LATE if published else NO_GATEWAY
    if missing := state.why_missing(_WORKER, client.config):
        return f"the gateway does not run: {missing}"
    report = next((worker.text for worker in state.workers if worker.worker == _WORKER), None)
    if published or report is not None:
        return f"{_LATE} ({report})" if report and "gateway" in report else _LATE
    daemons = ", ".join(sorted({document.daemon for document in documents})) or "none"
    return f"no gateway runs on this hub: no daemon {client.config.name} runs on this machine; on the hub: {daemons}"


def planner_away(client: CliClient, gateway: StatusDocument) -> Note | None:
    """Return why the planner cannot drive, from a gateway's status document: it is absent, or has inactive nodes."""
    inactive = inactive_nodes(gateway)
    if inactive is not None:
        return inactive
    if gateway.state != "waiting":
        return None
    planner = gateway.other(GatewayKeys).planner
    if gateway.daemon == client.config.name:  # another daemon's planners are in another configuration
        documents = documents_in(client.ask("status"))
        client.settle()
        note = absence(client.config.navigation, planner, client.endpoints(), documents)
        if note is not None:
            return note
    return Note(gateway.text or f"the planner {planner} is unreachable", "")


def published_status(client: CliClient, types: Types) -> dict[str, Any]:
    """Return the newest ``NavigationStatus``; raises `CliError` if none is published."""
    check_daemon(client)
    try:
        return Navigation(client, types).status()
    except ClientError as err:
        raise CliError(f"{err}: {no_answer(client)}") from None


def gateway_caller(client: CliClient, types: Types, verb: str) -> ServiceCaller:
    """Return a client of one of the gateway's services; raises `CliError` without a gateway."""
    check_daemon(client)
    try:
        return Navigation(client, types).service(verb)
    except ClientError as err:
        raise CliError(f"{err}\n{no_answer(client)}") from None

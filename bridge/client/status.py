"""Status documents of the workers on the hub."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bridge.client.errors import ClientError
from bridge.client.session import ASK_SECONDS, Client
from bridge.hub.control import WorkerAnswer
from bridge.hub.daemons import identity_of
from bridge.hub.namesakes import DaemonNames
from bridge.state_file import SERVICE_STATE

Document = Mapping[str, Any]
"""One worker's status document: what it answers to the verb ``status``."""


def ask_status(client: Client) -> list[Document]:
    """Return the status documents of all workers; raises `ClientError` if none answers."""
    documents = answered(client)
    if not documents:
        hint = "Is the daemon running ('midspan run'), and is this its domain (hub.domain)?"
        raise ClientError(f"a router answers, but no worker of Midspan does on {client.where}.\n{hint}")
    return documents


def answered(client: Client, seconds: float = ASK_SECONDS) -> list[Document]:
    """Return the status documents of the workers that answer in time."""
    return [document_of(answer) for answer in distinct(client, client.ask("status", timeout=seconds))]


def document_of(answer: WorkerAnswer) -> Document:
    """Return a worker's status document, or one with the error if it fails to answer."""
    if isinstance(answer.value, dict) and not answer.error:
        return {**answer.value, "daemon": answer.daemon, "worker": answer.worker}
    error = answer.error or "the answer is not a status document"
    return {"daemon": answer.daemon, "worker": answer.worker, "side": answer.worker, "state": "failed", "error": error}


def daemon_names(client: Client, status: Sequence[WorkerAnswer]) -> DaemonNames:
    """Return the names of the hub's daemons; ``status`` are all answers to ``status``, or those of the routers."""
    config = client.config
    places = [config] if config.state else [config, config.model_copy(update={"state": SERVICE_STATE})]
    own = [identity.instance for place in places if (identity := identity_of(place)) is not None]
    return DaemonNames(status, client.hub.zid, own if client.here else ())


def distinct(client: Client, status: Sequence[WorkerAnswer]) -> list[WorkerAnswer]:
    """Return all answers to ``status`` with distinct names of their daemons."""
    return daemon_names(client, status).apply(status)


def route_list(document: Document) -> list[Document]:
    """Return the routes of a status document, without malformed ones."""
    return dicts(document.get("routes"))


def port_list(document: Document) -> list[Document]:
    """Return the YARP ports of a status document."""
    return dicts(document.get("ports"))


def dicts(value: object) -> list[Document]:
    """Return the objects in a document's list; nothing if it is not a list."""
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def texts(value: object) -> list[str]:
    """Return a document's list as texts; nothing if it is not a list."""
    return [str(item) for item in value] if isinstance(value, list) else []

"""Status documents of the workers on the hub."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bridge.client.errors import ClientError
from bridge.client.session import ASK_SECONDS, Client
from bridge.hub.control import WorkerAnswer
from bridge.hub.daemons import identity_of
from bridge.hub.graph.tokens import Origin
from bridge.hub.namesakes import DaemonNames
from bridge.state_file import SERVICE_STATE
from bridge.status import StatusDocument, read_status


def ask_status(client: Client) -> list[StatusDocument]:
    """Return the status documents of all workers; raises `ClientError` if none answers."""
    documents = answered(client)
    if not documents:
        hint = "Is the daemon running ('midspan run'), and is this its domain (hub.domain)?"
        raise ClientError(f"a router answers, but no Midspan worker does on {client.where}.\n{hint}")
    return documents


def answered(client: Client, seconds: float = ASK_SECONDS) -> list[StatusDocument]:
    """Return the status documents of the workers that answer in time."""
    return [document_of(answer) for answer in distinct(client, client.ask("status", timeout=seconds))]


def documents_in(answers: Iterable[WorkerAnswer]) -> list[StatusDocument]:
    """Return the status documents in the workers' answers to ``status``, without those of workers that failed."""
    return [read_status(a.value, a.daemon, a.worker) for a in answers if isinstance(a.value, dict)]


def silent_workers(client: Client, documents: Iterable[StatusDocument]) -> list[Origin]:
    """Return the sides whose workers are on the hub, but sent none of the ``documents``."""
    answered = {document.zid for document in documents}
    origins = client.hub.graph.origins().items()
    # the zenoh worker has further sessions for its dialects
    return [origin for zid, origin in origins if zid not in answered and not origin.side.startswith("zenoh")]


def document_of(answer: WorkerAnswer) -> StatusDocument:
    """Return a worker's status document; if it failed to answer, a document with the error."""
    return read_status(answer.value, answer.daemon, answer.worker, answer.error)


def daemon_names(client: Client, status: Sequence[WorkerAnswer]) -> DaemonNames:
    """Return the names of the hub's daemons; ``status``: the replies of all workers, or of the routers."""
    config = client.config
    places = [config] if config.state else [config, config.model_copy(update={"state": SERVICE_STATE})]
    own = [identity.instance for place in places if (identity := identity_of(place)) is not None]
    return DaemonNames(status, client.hub.zid, own if client.here else ())


def distinct(client: Client, status: Sequence[WorkerAnswer]) -> list[WorkerAnswer]:
    """Return all answers to ``status``, with different names for different daemons of the same name."""
    return daemon_names(client, status).apply(status)

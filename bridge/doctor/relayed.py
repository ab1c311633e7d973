"""What workers relay between the hub's own nodes, from their status documents."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from bridge.hub.graph import HubEndpoint
from bridge.status import RelayedStatus, StatusDocument, WorkerStatus

Relayed = Collection[tuple[str, str, str, str]]
"""Name, type, hash of publishers or clients, and hash of subscriptions or servers of what is relayed."""


def relayed_keys(documents: Iterable[StatusDocument]) -> Relayed:
    """Return what the workers relay."""
    return {(row.topic, row.type, row.hash, other) for _, row in _rows(documents) for other in row.others}


def is_relayed(sender: HubEndpoint, receivers: Iterable[HubEndpoint], relayed: Relayed) -> bool:
    """Return whether messages or calls of an endpoint reach any of the receivers through a relay."""
    key = sender.topic, sender.type_name, sender.key_hash
    return any((*key, receiver.key_hash) in relayed for receiver in receivers)


def relay_texts(documents: Iterable[StatusDocument], names: Collection[str] | None = None) -> list[str]:
    """Return a text for each topic and service that is relayed, or for those with one of the names."""
    return [_text(document, row) for document, row in _rows(documents) if names is None or row.topic in names]


def _rows(documents: Iterable[StatusDocument]) -> list[tuple[WorkerStatus, RelayedStatus]]:
    return [(d, row) for d in documents if isinstance(d, WorkerStatus) for row in d.relay.names]


def _text(document: WorkerStatus, row: RelayedStatus) -> str:
    what = "calls" if row.kind == "service" else "messages"
    why = f"have other versions of {row.type}"
    if row.hash in row.others:
        why = f"do not receive the buffers of {row.type}"
    text = (
        f"{row.topic}: {document.worker} (daemon {document.daemon}) relays {what} from {', '.join(row.senders)} to"
        f" {', '.join(row.receivers)}, which {why}; {row.messages} so far"
    )
    return "; ".join(filter(None, (text, row.losses, row.error and f"last error: {row.error}")))

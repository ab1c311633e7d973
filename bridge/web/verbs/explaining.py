"""The verb that explains why a topic, a service or an action is bridged or not."""

from __future__ import annotations

from typing import Any

from bridge.client.graph import decisions_in
from bridge.client.session import Client
from bridge.client.status import daemon_names

_ASK_SECONDS = 1.0
_DECISION = ("daemon", "direction", "decision", "why", "cure", "users")


def explain(client: Client, name: str) -> list[dict[str, Any]]:
    """Return why a topic, a service or an action is bridged or not."""
    names = daemon_names(client, client.ask("status", worker="router", timeout=_ASK_SECONDS))
    decisions = decisions_in(names.apply(client.ask("explain", {"topic": name})))
    return [{"side": decision.worker, **{key: getattr(decision, key) for key in _DECISION}} for decision in decisions]

"""The identity of the hub's router: the name of its daemon, and its process id."""

from __future__ import annotations

import json
from typing import Any

import zenoh

from bridge.hub.graph.tokens import MIDSPAN_SPACE


def identity_key(zid: str) -> str:
    """Return the key on which a Midspan router answers with its identity."""
    return f"{MIDSPAN_SPACE}/router/{zid}"


def identity(daemon: str, pid: int) -> bytes:
    """Return a router's answer with its identity."""
    return json.dumps({"daemon": daemon, "pid": pid}).encode()


def ask_identity(session: zenoh.Session, zid: str, seconds: float) -> tuple[str, int]:
    """Return a router's daemon and process id; ("", 0) if it is not a Midspan router, or does not answer in time."""
    for reply in session.get(identity_key(zid), timeout=seconds):
        if reply.ok is not None:
            try:
                known: Any = json.loads(reply.ok.payload.to_bytes())
                return str(known["daemon"]), int(known["pid"])
            except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
                continue
    return "", 0

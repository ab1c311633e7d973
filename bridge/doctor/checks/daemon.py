"""Is the configuration good, and do the daemon and its workers answer?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, skip, warn


def look_at_config(around: Around) -> Sequence[Finding]:
    """The file's problems, and a hub that is open to everybody."""
    if not around.config_good:
        return [fail(line, "mend it; 'midspan config check' says the same") for line in around.config_text.splitlines()]
    findings = [ok(around.config_text)]
    door = around.config.hub.open
    if door.insecure:
        findings.append(
            warn(
                f"the hub is open without TLS at {', '.join((*door.listen, *door.connect))}: whoever reaches it joins",
                "certificates ('midspan keys'), and tls/ endpoints in hub.open",
            )
        )
    return findings


def look_at_workers(around: Around) -> Sequence[Finding]:
    """Who answers on the hub, and how they are."""
    if around.hub.error:
        return [warn(around.hub.error.splitlines()[0], "start the daemon: midspan run (or systemctl start midspan)")]
    if not around.hub.documents:
        domain = around.config.hub.domain
        return [
            warn(
                f"a router answers at {around.config.hub.listen}, but no worker does in domain {domain}",
                "start the daemon: midspan run; where it runs, compare hub.domain",
            )
        ]
    return [_worker(document) for document in around.hub.documents]


def _worker(document: Any) -> Finding:
    name = f"{document.get('daemon')}/{document.get('worker')}"
    state = document.get("state")
    if document.get("error"):
        return fail(f"{name} does not answer: {document['error']}", "look into its log: journalctl -u midspan")
    warnings = document.get("warnings") or []
    if warnings:
        return warn(f"{name} is {state}, and warns: {'; '.join(str(w) for w in warnings)}")
    if state == "waiting":
        return warn(f"{name} waits: its network is away", "see the checks of that side")
    if state in ("running", "standby"):
        return ok(f"{name} is {state}")
    return skip(f"{name} says {state}")

"""Is the configuration good, and do the daemon and its workers answer?"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from typing import Any

from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, skip, warn


def look_at_config(around: Around) -> Sequence[Finding]:
    """The file's problems, and a hub that is open to everybody."""
    if not around.config_good:
        return [fail(line, "mend it; 'midspan config check' says the same") for line in around.config_text.splitlines()]
    findings = [ok(around.config_text)]
    hub = around.config.hub
    over = hub.router_zenoh
    guarded = not isinstance(over, dict) or _has(over, "access_control") or _has(over, "transport", "link", "tls")
    if not _is_loopback(hub.listen) and (over is None or not guarded):
        findings.append(
            warn(
                f"the hub listens at {hub.listen} without TLS or access control: whoever reaches it can send commands",
                "give hub.router_zenoh transport/link/tls or access_control, or listen on 127.0.0.1",
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


def _has(tree: Any, *path: str) -> bool:
    for part in path:
        if not isinstance(tree, dict) or not tree.get(part):
            return False
        tree = tree[part]
    return True


def _is_loopback(endpoint: str) -> bool:
    host = endpoint.partition("/")[2].partition("?")[0].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or not endpoint.startswith(("tcp/", "tls/", "udp/", "quic/", "ws/"))

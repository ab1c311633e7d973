"""zenoh configurations of the hub's sessions: Midspan's defaults, overridden by the user's settings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import zenoh

from bridge.config.zenoh_values import Tree, changed
from bridge.hub.errors import HubConfigError, zenoh_reason

MAX_PAYLOAD = 256 << 20
"""Maximum size in bytes of a message on the hub."""

LEASE_MS = 3000
"""zenoh drops a session that was silent for this time, in which a live session sends four keep-alives."""

LISTENERS = ("tcp/127.0.0.1:0",)
"""Where a worker's session accepts links from other programs on this machine."""

CLIENT_WAIT_MS = 3000
"""Maximum time for which a session in zenoh's client mode waits for its router when it opens."""

_PACKETS = dict.fromkeys(("interactive_high", "data_high", "data", "data_low"), 16)
"""Packets in a link's queue, by priority; with zenoh's default of 2, a short burst is lost on a busy machine."""

_FAR_MS, _NEAR_MS = 200, 2000
"""Maximum time for which a message of many packets waits for room in a link's queue before zenoh drops it.

With zenoh's default of 50 ms, a message of 10 MB is lost on a busy machine. The first message for a hanging peer delays
the following messages by this time. Routers (`_FAR_MS`) have links to other machines, which may stall. A worker's links
(`_NEAR_MS`) stay on its machine, where only messages that do not fit into the shared memory have many packets: 50 MB
take 0.2 s, or more than a second on a busy machine.
"""

_SMALL_MS = 20
"""Maximum time for which a message of one packet waits for room in a link's queue before zenoh drops it.

With zenoh's default of 1 ms, one message in a hundred is lost next to 40 MB/s for the same subscriber, when its process
did not run for a moment. A hanging peer delays the following messages by this time once; after that, zenoh drops
messages without waiting until the link accepts them again.
"""

POOL = 16 << 20
"""Bytes of shared memory that one session may use, so that the workers of one machine fit into a /dev/shm of 64 MB."""

THRESHOLD = 64 << 10
"""Minimum size in bytes of a message that goes through shared memory. Smaller messages are as fast on the network link;
and as soon as a sender's pool is used, zenoh locks the whole pool into memory in each process that receives from it."""


def session_tree(router: str | None, *, shared_memory: bool, max_payload: int) -> Tree:
    """Return the configuration of a worker's session: a peer that finds others via the router and links directly."""
    tree = _common_tree(max_payload, _NEAR_MS)
    tree["mode"] = "peer"
    tree["listen"] = {"endpoints": list(LISTENERS)}
    tree["connect"] = {
        "endpoints": [] if router is None else [router],
        # a peer does not wait for its router but retries, even after losing the link; a client cannot open without it
        "timeout_ms": {"router": -1, "peer": -1, "client": CLIENT_WAIT_MS},
        "exit_on_failure": {"router": False, "peer": False, "client": True},
        "retry": {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2},
    }
    tree["transport"]["shared_memory"] = {
        "enabled": shared_memory,
        "mode": "lazy",
        "transport_optimization": {"enabled": shared_memory, "pool_size": POOL, "message_size_threshold": THRESHOLD},
    }
    return tree


def router_tree(listen: Sequence[str], *, max_payload: int) -> Tree:
    """Return the configuration of a router, which forwards the contents of shared memory as bytes."""
    tree = _common_tree(max_payload, _FAR_MS)
    tree["mode"] = "router"
    tree["listen"] = {"endpoints": list(listen), "exit_on_failure": True}
    tree["connect"] = {"timeout_ms": -1, "exit_on_failure": False}
    tree["transport"]["shared_memory"] = {"enabled": False}
    return tree


def client_session_config(listen: str, user: Mapping[str, Any] | str | Path | None, seconds: float) -> zenoh.Config:
    """Return the configuration of a client of the router at ``listen``, which must answer within ``seconds``.

    A client reaches the whole hub as soon as its only link is up; a peer first has to discover every other session.
    ``user`` is the workers' configuration, which is needed for TLS. Raises `HubConfigError`.
    """
    router = connect_endpoint(listen)
    config = make_config(session_tree(router, shared_memory=False, max_payload=MAX_PAYLOAD), user)
    for key, value in (
        ("mode", "client"),
        ("connect/timeout_ms", int(seconds * 1000)),
        ("connect/exit_on_failure", True),
        ("listen/endpoints", []),
    ):
        config.insert_json5(key, json.dumps(value))
    return without_shared_memory(config)


def without_shared_memory(config: zenoh.Config) -> zenoh.Config:
    """Disable shared memory in a configuration, and return the configuration."""
    config.insert_json5("transport/shared_memory/enabled", "false")
    return config


def make_config(tree: Tree, user: Mapping[str, Any] | str | Path | None) -> zenoh.Config:
    """Return Midspan's configuration, overridden by the user's.

    Args:
        tree: Midspan's defaults.
        user: inline, or the path of a JSON5 or YAML file. Mappings are merged key by key; lists are replaced as a
            whole. A value in a file that equals zenoh's default counts as missing.

    Raises:
        HubConfigError: the file cannot be read, or zenoh refuses a key or value.
    """
    try:
        if isinstance(user, str | Path):
            over = changed(json.loads(str(zenoh.Config.from_file(user))), json.loads(str(zenoh.Config())))
        else:
            over = dict(user or {})
        return zenoh.Config.from_json5(json.dumps(merge(tree, over)))
    except (zenoh.ZError, TypeError, ValueError) as err:
        source = f"zenoh configuration {user}" if isinstance(user, str | Path) else "zenoh configuration"
        raise HubConfigError(f"{source} cannot be used: {zenoh_reason(err)}") from None


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> Tree:
    """Return a new mapping of ``base``, overridden by ``over`` key by key at each level."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = merge(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return merged


def connect_endpoint(listen: str) -> str:
    """Return the endpoint to which this machine's programs connect to reach a listener at ``listen``."""
    for everywhere, loopback in (("/0.0.0.0:", "/127.0.0.1:"), ("/[::]:", "/[::1]:")):
        listen = listen.replace(everywhere, loopback, 1)
    return listen


def _common_tree(max_payload: int, wait_ms: int) -> Tree:
    drop = {"wait_before_drop": _SMALL_MS * 1000, "max_wait_before_drop_fragments": wait_ms * 1000}
    return {
        "scouting": {
            "delay": 0,
            "multicast": {"enabled": False},
            "gossip": {
                "enabled": True,
                "target": {"router": ["router", "peer"], "peer": ["router", "peer"]},
                "autoconnect": {"router": [], "peer": ["router", "peer"]},
                # one of two peers connects, not both
                "autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
            },
        },
        # caches and late joiners need the timestamp of each sample
        "timestamping": {"enabled": True},
        "transport": {
            "link": {
                "tx": {
                    "lease": LEASE_MS,
                    "keep_alive": 4,
                    "queue": {"size": _PACKETS, "congestion_control": {"drop": drop}},
                },
                "rx": {"max_message_size": max_payload + 65536},
            }
        },
    }

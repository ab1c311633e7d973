"""zenoh configurations of the hub's sessions: Midspan's defaults with the user's own laid over them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import zenoh

from bridge.hub.errors import HubConfigError, zenoh_reason

Tree = dict[str, Any]

MAX_PAYLOAD = 256 << 20
"""Bytes of the largest message that the hub takes by default."""

LEASE_MS = 3000
"""A session that fell silent is given up after this time; four keep-alives are sent in it."""

CLIENT_WAIT_MS = 3000
"""How long a session in zenoh's client mode waits for its router to answer when it is opened."""

_PACKETS = dict.fromkeys(("interactive_high", "data_high", "data", "data_low"), 16)
"""Packets that wait for a link, by priority; with zenoh's 2 a short burst of samples is lost on a busy machine."""

_FAR_MS, _NEAR_MS = 200, 2000
"""How long a message of many packets may take to get into a link's queue, before it is dropped there.

With zenoh's 50 ms one of 10 MB is lost on a busy machine. The first one for a peer that stands still delays what comes
behind it by so much. Routers have links to other machines, which stall. A worker's stay on its machine, where only what
is too large for the shared memory has many packets: 50 MB take 0.2 s, and more than a second where others compute.
"""

_SMALL_MS = 20
"""How long a message of one packet may take to get into a link's queue, before it is dropped there.

With zenoh's 1 ms one in a hundred is lost beside 40 MB/s to the same subscriber, whose process had no turn for a
moment. A peer that stands still delays what comes behind it by so much once; then zenoh drops without waiting, until
the link takes messages again.
"""

POOL = 16 << 20
"""Bytes of shared memory that one session may use; the workers of one machine fit a /dev/shm of 64 MB."""

THRESHOLD = 64 << 10
"""Bytes from which a message goes through shared memory. Smaller ones cross the network link as fast; and zenoh locks a
sender's whole pool into memory, in each process that receives from it, once it has used it."""


def session_tree(router: str | None, *, shared_memory: bool, max_payload: int) -> Tree:
    """Configuration of a worker's session: a peer that finds the others over the router and links to them directly."""
    tree = _common_tree(max_payload, _NEAR_MS)
    tree["mode"] = "peer"
    tree["listen"] = {"endpoints": ["tcp/127.0.0.1:0"]}
    tree["connect"] = {
        "endpoints": [] if router is None else [router],
        # a peer does not wait for its router: it goes on trying, also when the link is cut later; zenoh cannot open a
        # client without one
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
    """Configuration of a router; it passes on shared memory's contents as bytes."""
    tree = _common_tree(max_payload, _FAR_MS)
    tree["mode"] = "router"
    tree["listen"] = {"endpoints": list(listen), "exit_on_failure": True}
    tree["connect"] = {"timeout_ms": -1, "exit_on_failure": False}
    tree["transport"]["shared_memory"] = {"enabled": False}
    return tree


def client_session_config(listen: str, user: Mapping[str, Any] | str | Path | None, seconds: float) -> zenoh.Config:
    """Configuration of a client of the router at ``listen``, which must answer within so many seconds.

    A client knows the whole hub as soon as its one link stands; a peer would have to find every other first. ``user``
    is the workers' own, for TLS. Raises `HubConfigError`.
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
    return config


def make_config(tree: Tree, user: Mapping[str, Any] | str | Path | None) -> zenoh.Config:
    """Lay the user's configuration over ours.

    Args:
        tree: Midspan's defaults.
        user: inline, or the path of a JSON5 or YAML file. Mappings are merged key by key, lists replaced whole. Of a
            file, what equals zenoh's own default counts as left out.

    Raises:
        HubConfigError: the file cannot be read, or zenoh does not know a key or value.
    """
    try:
        if isinstance(user, str | Path):
            over = _set_values(json.loads(str(zenoh.Config.from_file(user))), json.loads(str(zenoh.Config())))
        else:
            over = dict(user or {})
        return zenoh.Config.from_json5(json.dumps(merge(tree, over)))
    except (zenoh.ZError, TypeError, ValueError) as err:
        source = f"zenoh configuration {user}" if isinstance(user, str | Path) else "zenoh configuration"
        raise HubConfigError(f"{source} cannot be used: {zenoh_reason(err)}") from None


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> Tree:
    """A new mapping with ``over`` laid over ``base``, key by key at each level."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = merge(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return merged


def connect_endpoint(listen: str) -> str:
    """Where a program on this machine reaches what listens on ``listen``."""
    for everywhere, here in (("/0.0.0.0:", "/127.0.0.1:"), ("/[::]:", "/[::1]:")):
        listen = listen.replace(everywhere, here, 1)
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
        # caches and late joiners need the time of each sample
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


def _set_values(tree: Tree, defaults: Mapping[str, Any]) -> Tree:
    found: Tree = {}
    for key, value in tree.items():
        default = defaults.get(key)
        if isinstance(value, dict) and isinstance(default, Mapping):
            below = _set_values(value, default)
            if below:
                found[key] = below
        elif value is not None and value != default:
            found[key] = value
    return found

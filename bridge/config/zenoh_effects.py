"""Checks zenoh settings that zenoh accepts, but with which sessions cannot open, or cannot join."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bridge.config.document import KeyPath
from bridge.config.sections.section import is_loopback
from bridge.config.zenoh_values import Tree, texts

if TYPE_CHECKING:
    from bridge.config.model import Config

Flaw = tuple[KeyPath, str]
"""The place of a problem within one zenoh configuration, and its text."""

WORKERS: KeyPath = ("hub", "zenoh")
ROUTER: KeyPath = ("hub", "router_zenoh")
OPEN: KeyPath = ("hub", "open", "zenoh")
DIALECTS: KeyPath = ("zenoh", "zenoh")

_LEAST: tuple[tuple[KeyPath, int, str], ...] = (
    (("transport", "link", "rx", "max_message_size"), 65536, "message"),
    (("transport", "link", "tx", "batch_size"), 32, "message"),
    (("transport", "link", "tx", "keep_alive"), 1, "link"),
    (("transport", "unicast", "accept_pending"), 1, "link"),
    (("transport", "unicast", "accept_timeout"), 1, "link"),
    (("transport", "unicast", "max_sessions"), 1, "link"),
    (("transport", "unicast", "open_timeout"), 1, "link"),
)
"""Numbers with their least useful value, and what lower values prevent (tried with zenoh 1.10.2)."""

_LEASE: KeyPath = ("transport", "link", "tx", "lease")
_LEAST_LEASE_MS = 500
"""Shorter leases end links whenever a busy machine delays a keep-alive, of which zenoh sends four in a lease."""

_SESSIONS: KeyPath = ("transport", "unicast", "max_sessions")
_LEAST_SESSIONS = 16
"""Least number of sessions for the workers of one daemon and its commands."""

_PROTOCOLS: KeyPath = ("transport", "link", "protocols")
_GOSSIP: KeyPath = ("scouting", "gossip", "enabled")
_MULTIHOP: KeyPath = ("scouting", "gossip", "multihop")
_MULTICAST: KeyPath = ("scouting", "multicast", "enabled")
_PEERS: KeyPath = ("listen", "endpoints")
_MEETING: dict[KeyPath, tuple[KeyPath, str]] = {
    WORKERS: (("connect", "endpoints"), "the workers would not reach the daemon's router"),
    ROUTER: (("listen", "endpoints"), "workers and commands would not reach the router"),
    OPEN: (("connect", "endpoints"), "other machines would not reach this machine's programs"),
}
"""For each session of the hub, the list that contains ``hub.listen``, and what happens without."""


def unusable(tree: Tree, section: KeyPath, config: Config) -> Iterator[Flaw]:
    """Yield settings that zenoh accepts, but with which nothing would join, or nothing would be found.

    ``config`` has the zenoh configurations of files inline.
    """
    for path, least, what in _LEAST:
        if isinstance(value := _found(tree, path), int) and value < least:
            yield path, f"{value} permits no {what}; leave it out"
    if isinstance(value := _found(tree, _LEASE), int) and value < _LEAST_LEASE_MS:
        yield _LEASE, f"{value} ms would end links again and again; set at least {_LEAST_LEASE_MS}, or leave it out"
    yield from _denies_everything(tree)
    protocols, listens = _found(tree, _PROTOCOLS), config.hub.listen.partition("/")[0]
    if protocols is not None and section != DIALECTS and listens not in protocols:
        yield _PROTOCOLS, f"must contain {listens!r}, the protocol of 'hub.listen'"
    elif protocols == []:
        yield _PROTOCOLS, "permits no link; leave it out"
    if section == DIALECTS:
        yield from _shared_listeners(tree, len(config.zenoh.dialects))
        yield from _without_router(tree) if config.zenoh.router is None else ()
        return
    yield from _elsewhere(tree, section, config)
    if section == OPEN:
        return
    if tree.get("namespace"):
        yield ("namespace",), "workers and commands would not find each other; 'hub.domain' separates hubs"
    if isinstance(value := _found(tree, _SESSIONS), int) and 0 < value < _LEAST_SESSIONS:
        yield _SESSIONS, f"{value} sessions are too few for the workers and commands; set at least {_LEAST_SESSIONS}"
    workers = config.hub.zenoh if isinstance(config.hub.zenoh, dict) else {}
    if workers.get("mode", "peer") == "peer" and not _found(workers, _MULTICAST):
        yield from _unknown_peers(tree, section, config)
    if section == WORKERS and tree.get("mode", "peer") == "peer" and _of_mode(_found(tree, _PEERS), "peer") == []:
        yield _PEERS, "workers would not connect to each other; leave it out"


_TOLD: dict[KeyPath, tuple[str, tuple[tuple[str, str], ...]]] = {
    WORKERS: ("peer", (("target", "router"), ("autoconnect", "peer"))),
    ROUTER: ("router", (("target", "peer"),)),
}
"""The mode of the hub's sessions, and the modes that some of their lists of modes need: a worker's address goes to the
router, and from there to the other workers, which connect (tried with zenoh 1.10.2)."""


def _unknown_peers(tree: Tree, section: KeyPath, config: Config) -> Iterator[Flaw]:
    """Yield the settings of gossip with which workers that are peers would not learn each other's addresses."""
    if _found(tree, _GOSSIP) is False:
        yield _GOSSIP, "workers would not find each other; leave it out"
    mode, lists = _TOLD[section]
    for key, other in lists:
        path = *_GOSSIP[:-1], key
        if (modes := _of_mode(_found(tree, path), mode)) is not None and other not in modes:
            yield path, f"workers would not connect to each other without {other!r} in this list; leave it out"
    elsewhere = config.hub.router is False or _found(config.hub.router_zenoh, _MULTIHOP)
    if section == WORKERS and _found(tree, _MULTIHOP) and not elsewhere:
        yield _MULTIHOP, "workers would not find each other unless 'hub.router_zenoh' has it, too; leave it out"


def _denies_everything(tree: Tree) -> Iterator[Flaw]:
    """Yield a flaw for an access control that allows nothing; zenoh's default is to deny."""
    access = tree.get("access_control") or {}
    if not access.get("enabled") or access.get("default_permission", "deny") != "deny":
        return
    used = {name for policy in access.get("policies") or () for name in policy.get("rules") or ()}
    if not any(rule["permission"] == "allow" and rule["id"] in used for rule in access.get("rules") or ()):
        text = "allows nothing: no policy has a rule with 'permission: allow'; add one, or 'default_permission: allow'"
        yield ("access_control",), text


def _elsewhere(tree: Tree, section: KeyPath, config: Config) -> Iterator[Flaw]:
    """Yield a flaw for a list that replaces Midspan's, but lacks the endpoint at which the hub's sessions meet."""
    path, effect = _MEETING[section]
    endpoints, place = _found(tree, path), config.hub.listen
    if endpoints is None or config.hub.router is False or (section == WORKERS and _found(tree, _MULTICAST)):
        return
    mode = "router" if section != WORKERS else tree.get("mode", "peer")
    if not any(_same_place(text, place) for _, text in texts(_of_mode(endpoints, mode), ())):
        cure = f"add {place!r} (hub.listen)"
        if section == WORKERS:
            cure += ", or set 'hub.router: false' if this daemon has no router"
        yield path, f"{effect}, because the list replaces Midspan's; {cure}"


def _of_mode(value: Any, mode: str) -> Any:
    """Return the part for one mode of a value that may depend on the mode; None if it has none."""
    return value.get(mode) if isinstance(value, dict) else value


def _same_place(one: str, other: str) -> bool:
    """Whether two endpoints on this machine are the same, by any name of loopback."""
    (protocol, host, port), (other_protocol, other_host, other_port) = map(_split, (one, other))
    same_host = host == other_host or ("localhost" in (host, other_host) and is_loopback(one))
    return protocol == other_protocol and port == other_port and same_host


def _split(endpoint: str) -> tuple[str, str, str]:
    protocol, _, address = re.split(r"[?#]", endpoint)[0].partition("/")
    host, _, port = address.rpartition(":")
    return protocol, host, port


def _shared_listeners(tree: Tree, sessions: int) -> Iterator[Flaw]:
    """Yield the listeners with a fixed port, which only the session of one dialect can open."""
    for path, text in texts((tree.get("listen") or {}).get("endpoints"), ("listen", "endpoints")):
        if sessions > 1 and not re.search(r":0(?:[?#]|$)", text):
            yield (
                path,
                f"only one of the {sessions} dialects could listen at {text}; use port 0, or connect to a router",
            )


def _without_router(tree: Tree) -> Iterator[Flaw]:
    """Yield a flaw for a client that cannot find a router: it has no endpoint, and Midspan turns scouting off."""
    connect, multicast = tree.get("connect") or {}, (tree.get("scouting") or {}).get("multicast") or {}
    endpoints = next(texts(connect.get("endpoints"), ()), None)
    if tree.get("mode") == "client" and endpoints is None and not multicast.get("enabled"):
        yield ("mode",), "a client needs the address of its router: set zenoh.router, or 'connect: {endpoints: [...]}'"


def _found(tree: Any, path: KeyPath) -> Any:
    """Return the value at a path, None if there is none."""
    for part in path:
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree

"""Checks zenoh settings that zenoh accepts, but with which sessions cannot open, or cannot join."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bridge.config.document import KeyPath

if TYPE_CHECKING:
    from bridge.config.model import Config

Tree = dict[str, Any]
Flaw = tuple[KeyPath, str]
"""The place of a problem within one zenoh configuration, and its text."""

WORKERS: KeyPath = ("hub", "zenoh")
ROUTER: KeyPath = ("hub", "router_zenoh")
DIALECTS: KeyPath = ("zenoh", "zenoh")

_MAX_SESSIONS: KeyPath = ("transport", "unicast", "max_sessions")
_PROTOCOLS: KeyPath = ("transport", "link", "protocols")


def unusable(tree: Tree, section: KeyPath, config: Config) -> Iterator[Flaw]:
    """Yield settings that zenoh accepts, but with which nothing would join, or nothing would be found."""
    for path, what in ((("transport", "link", "tx", "batch_size"), "message"), (_MAX_SESSIONS, "link")):
        if found(tree, path) == 0:
            yield path, f"0 permits no {what}; leave it out"
    if section not in (WORKERS, ROUTER):
        return
    if tree.get("namespace"):
        yield ("namespace",), "workers and commands would not find each other; 'hub.domain' separates hubs"
    protocols, listens = found(tree, _PROTOCOLS), config.hub.listen.partition("/")[0]
    if protocols and listens not in protocols:
        yield _PROTOCOLS, f"must contain {listens!r}, the protocol of 'hub.listen'"


def shared_listeners(tree: Tree, sessions: int) -> Iterator[Flaw]:
    """Yield the listeners with a fixed port, which only the session of one dialect can open."""
    for path, text in texts((tree.get("listen") or {}).get("endpoints"), ("listen", "endpoints")):
        if sessions > 1 and not re.search(r":0(?:[?#]|$)", text):
            yield (
                path,
                f"only one of the {sessions} dialects could listen at {text}; use port 0, or connect to a router",
            )


def without_router(tree: Tree) -> Iterator[Flaw]:
    """Yield a flaw for a client that cannot find a router: it has no endpoint, and Midspan turns scouting off."""
    connect, multicast = tree.get("connect") or {}, (tree.get("scouting") or {}).get("multicast") or {}
    endpoints = next(texts(connect.get("endpoints"), ()), None)
    if tree.get("mode") == "client" and endpoints is None and not multicast.get("enabled"):
        yield ("mode",), "a client needs the address of its router: set zenoh.router, or 'connect: {endpoints: [...]}'"


def found(tree: Any, path: KeyPath) -> Any:
    """Return the value at a path, None if there is none."""
    for part in path:
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree


def texts(value: Any, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    """Yield each text within a value, with its path; ``path`` is the path of the value."""
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict | list):
        for part, inner in value.items() if isinstance(value, dict) else enumerate(value):
            if part != "strategy":
                yield from texts(inner, (*path, part))

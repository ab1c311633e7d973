"""The registrations of a master: its nodes, with their addresses, topics, services and subscribed parameters."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import NamedTuple

MAX_REGISTRATIONS = 200_000
MAX_TYPES = 100_000
"""Maximum number of topic types; beyond it, the types of topics without nodes are dropped."""


class Kind(Enum):
    """The kinds of registrations."""

    PUBLISHER = 0
    SUBSCRIBER = 1
    SERVICE = 2
    PARAMETER = 3


class Link(NamedTuple):
    """The name and the XML-RPC address of a node that has registered."""

    node: str
    api: str


class Node:
    """A registered node.

    Attributes:
        api: the node's XML-RPC address.
        reachable: whether the node has answered this master since it registered.
        keys: for each kind, the names that the node has registered, in order.
    """

    def __init__(self, api: str) -> None:
        self.api = api
        self.reachable = False
        self.keys: dict[Kind, dict[str, None]] = {kind: {} for kind in Kind}

    @property
    def empty(self) -> bool:
        """Whether the node has no registration left."""
        return not any(self.keys.values())


class Removal(NamedTuple):
    """A node whose registrations were removed: its address, and the topics that it published."""

    api: str
    topics: list[str]


class RegistrationsFullError(Exception):
    """There are too many registrations to add another."""


class Registrations:
    """All registrations of one master. Names are resolved. Not thread-safe."""

    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {}
        self.types: dict[str, str] = {}
        self.service_apis: dict[str, tuple[str, str]] = {}
        self._links: dict[Kind, dict[str, dict[Link, None]]] = {kind: {} for kind in Kind}
        self._count = 0

    def register(self, kind: Kind, key: str, node: str, api: str, service_api: str = "") -> Removal | None:
        """Register a node; return its previous registrations if they were removed because its address has changed.

        A service has one server: the last one that registered.
        """
        if self._count >= MAX_REGISTRATIONS:
            raise RegistrationsFullError(f"there are {MAX_REGISTRATIONS} registrations already")
        entry = self.nodes.get(node)
        removal = self.remove_node(node) if entry is not None and entry.api != api else None
        entry = self.nodes.setdefault(node, Node(api))
        self._count += key not in entry.keys[kind]
        entry.keys[kind][key] = None
        links = self._links[kind].setdefault(key, {})
        if kind is Kind.SERVICE:
            links.clear()
            self.service_apis[key] = (node, service_api)
        links[Link(node, api)] = None
        return removal

    def unregister(self, kind: Kind, key: str, node: str, api: str) -> tuple[str, int]:
        """Remove a registration if it is current; return a message, and the number of removed registrations.

        ``api`` is the service's address for a service, else the node's.
        """
        entry = self.nodes.get(node)
        if entry is None:
            return f"[{node}] is not a registered node", 0
        message, count = self._remove(kind, key, node, api)
        if count:
            del entry.keys[kind][key]
            self._count -= 1
        if entry.empty:
            del self.nodes[node]
        return message, count

    def _remove(self, kind: Kind, key: str, node: str, api: str) -> tuple[str, int]:
        links = self._links[kind].get(key, {})
        if kind is Kind.SERVICE:
            if self.service_apis.get(key) != (node, api):
                return f"[{api}] is no longer the current service api handle for [{key}]", 0
            del self.service_apis[key]
            links.clear()
        elif links.pop(Link(node, api), True):
            return f"[{node}] is not a known provider of [{key}]", 0
        if not links:
            del self._links[kind][key]
        return f"Unregistered [{node}] as provider of [{key}]", 1

    def remove_node(self, node: str) -> Removal:
        """Remove a node with all of its registrations; raises `KeyError` if it is not registered."""
        entry = self.nodes.pop(node)
        for kind, keys in entry.keys.items():
            self._count -= len(keys)
            for key in keys:
                links = self._links[kind].get(key, {})
                links.pop(Link(node, entry.api), None)
                if not links:
                    self._links[kind].pop(key, None)
        for service in entry.keys[Kind.SERVICE]:
            if service in self.service_apis and self.service_apis[service][0] == node:
                del self.service_apis[service]
        return Removal(entry.api, list(entry.keys[Kind.PUBLISHER]))

    def set_type(self, topic: str, type_name: str, *, publisher: bool) -> None:
        """Store a topic's type; a publisher's type has precedence, and ``*`` never replaces a type."""
        unknown, definite = topic not in self.types, type_name != "*"
        if (unknown or definite) if publisher else (unknown and definite):
            self.types[topic] = type_name
        if len(self.types) > MAX_TYPES:
            used = self._links[Kind.PUBLISHER].keys() | self._links[Kind.SUBSCRIBER].keys()
            self.types = {name: value for name, value in self.types.items() if name in used}

    def links(self, kind: Kind, key: str) -> list[Link]:
        """Return the nodes that have registered a name."""
        return list(self._links[kind].get(key, ()))

    def apis(self, kind: Kind, key: str) -> list[str]:
        """Return the addresses of the nodes that have registered a name."""
        return [link.api for link in self._links[kind].get(key, ())]

    def keys(self, kind: Kind) -> list[str]:
        """Return all registered names."""
        return list(self._links[kind])

    def state(self, kind: Kind) -> list[list[object]]:
        """Return each name with its nodes, as in ``getSystemState``."""
        return [[key, [link.node for link in links]] for key, links in self._links[kind].items()]

    def __iter__(self) -> Iterator[tuple[Kind, str, Link, str]]:
        """Yield kind, name, node and service address of each registration, in an order for registering them again."""
        for kind, names in self._links.items():
            for key, links in names.items():
                for link in links:
                    yield kind, key, link, self.service_apis[key][1] if kind is Kind.SERVICE else ""

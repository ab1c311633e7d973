"""The state of a master, and its reader."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from bridge.adapters.ros1_peers import Ros1ProtocolError, XmlRpcClient

_TRIES = 3

_RATE = 200_000
"""Average bytes of state that are read from a master per second: the larger the state, the longer the pauses between
reads, up to `_LONGEST`. The state of 500 topics has 250 kB, which costs ``rosmaster`` 4 ms of CPU time. Each read
delays messages, and less than 1 % of them may be affected."""

_LONGEST = 2.0
"""Longest time between two reads in seconds, unless the configuration sets a longer one."""

NAMESPACE = "/midspan"
"""Namespace of Midspan's own master parameters."""

PRESENCE = f"{NAMESPACE}/nodes"
"""Master parameter with an entry for each Midspan node."""


class Registration(NamedTuple):
    """One node's registration for one topic or service; ``topic`` is the topic's or service's name as registered.

    ``uri`` is the node's XML-RPC address, or a service's address (``rosrpc://host:port``); "" if unknown.
    """

    node: str
    topic: str
    uri: str


def publisher_id(link: Registration, *, latching: bool) -> str:
    """Return the id of a publisher's endpoint; if a node advertises again, now latched, this is another publisher."""
    return f"publisher {link.topic} {link.node} {link.uri}{' latched' if latching else ''}"


def node_of(publisher: str) -> tuple[str, str]:
    """Return node name and XML-RPC address from an id of `publisher_id`."""
    node, uri = publisher.removesuffix(" latched").split(" ")[2:4]
    return node, uri


@dataclass(frozen=True)
class MasterState:
    """The state of a master at one time.

    ``run`` contains the run id and the process id, so it changes when the master is restarted. ``network`` is the
    master's ``/run_id``, which roscore sets, or a bare rosmaster's address and process id. ``uris`` are the nodes'
    XML-RPC addresses; ``presence`` has the entries of `PRESENCE` by their key.
    """

    run: str
    network: str
    publishers: frozenset[Registration] = frozenset()
    subscribers: frozenset[Registration] = frozenset()
    servers: frozenset[Registration] = frozenset()
    types: Mapping[str, str] = field(default_factory=dict)
    uris: Mapping[str, str] = field(default_factory=dict)
    presence: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


class MasterReader:
    """Reads a master's state; an unchanged state costs one request and no parsing."""

    def __init__(self, client: XmlRpcClient, caller: str) -> None:
        self.caller = caller
        self._client = client
        self._size = 0
        self._nodes: tuple[str, ...] = ()
        self._answers: list[Any] = []
        self._state: MasterState | None = None
        self._servers: dict[Registration, str] = {}
        self._to_recheck: set[str] = set()

    def recheck_service(self, service: str) -> None:
        """Look up a service's address again in the next read. Thread-safe."""
        self._to_recheck.add(service)

    def pause(self, period: float) -> float:
        """Return the seconds to the next read: at least ``period``, and longer if the master's state is large."""
        return max(period, min(self._size / _RATE, _LONGEST))

    def read(self) -> MasterState:
        """Return the master's state; the same object as before if nothing changed. Raises `Ros1Error`."""
        try:
            return self._try_read()
        except (LookupError, TypeError, ValueError) as err:
            self._nodes, self._answers, self._state = (), [], None
            raise Ros1ProtocolError(f"the master's state is malformed: {err}") from None

    def _try_read(self) -> MasterState:
        for _ in range(_TRIES):
            nodes = self._nodes
            answers = self._ask()
            if answers == self._answers and self._state is not None and not self._to_recheck:
                return self._state
            self._nodes = tuple(sorted({node for kind in _state(answers) for _, names in kind for node in names}))
            if self._nodes == nodes:
                break
        self._answers = []  # until the state is complete: a read after a failed look-up must not return the old state
        state = _read(answers, nodes)
        state = replace(state, servers=self._addresses(_state(answers)[2], state.uris))
        # if nodes appeared during the address look-up, the next read repeats it
        self._answers = answers if self._nodes == nodes else []
        if state != self._state:
            self._state = state
        assert self._state is not None
        return self._state

    def _addresses(self, services: list[tuple[str, list[str]]], uris: Mapping[str, str]) -> frozenset[Registration]:
        """Return each service's server; look up an address once, and again if the node changes or on request."""
        listed = {Registration(nodes[0], name, uris.get(nodes[0], "")) for name, nodes in services if nodes}
        recheck, self._to_recheck = self._to_recheck, set()
        self._servers = {k: uri for k, uri in self._servers.items() if k in listed and k.topic not in recheck}
        new = sorted(listed - self._servers.keys())
        addresses = self._client.calls([("lookupService", (self.caller, link.topic)) for link in new]) if new else []
        self._servers |= {link: uri for link, uri in zip(new, addresses, strict=True) if isinstance(uri, str)}
        return frozenset(Registration(k.node, k.topic, self._servers.get(k, "")) for k in listed)

    def _ask(self) -> list[Any]:
        me, self._size = self.caller, 0  # an unreachable master is retried at the normal rate
        answers = self._client.calls([
            ("getSystemState", (me,)), ("getTopicTypes", (me,)), ("getParam", (me, "/run_id")),
            ("getParam", (me, PRESENCE)), ("getPid", (me,)), ("getUri", (me,)),
            *(("lookupNode", (me, node)) for node in self._nodes),
        ])  # fmt: skip
        self._size = self._client.size
        return answers


def _read(answers: list[Any], nodes: tuple[str, ...]) -> MasterState:
    types, run_id, presence, pid, uri = answers[1:6]
    uris = {n: u for n, u in zip(nodes, answers[6:], strict=True) if isinstance(u, str)}
    publishers, subscribers, _ = _state(answers)
    network = run_id if isinstance(run_id, str) and run_id else f"{uri}#{pid}"
    return MasterState(
        run=f"{network}#{pid}",
        network=network,
        publishers=_links(publishers, uris),
        subscribers=_links(subscribers, uris),
        types={str(name): str(type_) for name, type_ in types or ()},
        uris=uris,
        presence={k: v for k, v in presence.items() if isinstance(v, dict)} if isinstance(presence, dict) else {},
    )


_State = tuple[list[tuple[str, list[str]]], ...]


def _state(answers: list[Any]) -> _State:
    """Return publishers, subscribers and services, each as pairs of a name and its nodes."""
    kinds = answers[0] if isinstance(answers[0], list) else [[], [], []]
    return tuple([(str(name), [str(n) for n in nodes]) for name, nodes in kind] for kind in kinds[:3])


def _links(kind: list[tuple[str, list[str]]], uris: Mapping[str, str]) -> frozenset[Registration]:
    return frozenset(Registration(node, topic, uris.get(node, "")) for topic, nodes in kind for node in nodes)

"""The thread that calls the master: reads its graph, and maintains this node's registrations.

A rospy node registers once and never again. Here the node's wanted registrations are compared with the master's state
at each read, and the differences are corrected; so a restarted master, or one that lost the registrations, has them
again after one read.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from bridge.adapters.ros1.graph.presence import Ledger, NodeEntry, is_alive, removal_calls
from bridge.adapters.ros1.graph.state import MasterReader, MasterState, Registration
from bridge.adapters.ros1.node.node import Ros1Node
from bridge.adapters.ros1_peers import Call, Ros1Error, Ros1ProtocolError, UnreachableError, XmlRpcClient, ask

_log = logging.getLogger(__name__)

_TIMEOUT = 2.0
_STOP_TIMEOUT = 0.7
_RETRY = 0.1
_FAILURES = 2
_PATIENCE = 5.0
"""Seconds without a response, on a busy machine, before the master counts as unreachable."""

_BATCH = 200
SIM_TIME = "/use_sim_time"
"""The parameter by which ROS 1 nodes, as they start, decide to run on ``/clock`` (wiki.ros.org/Clock)."""

_SPARE_NAMES = 9

Seen = Callable[[MasterState | None], None]
Lost = Callable[[str], None]


class _Own(NamedTuple):
    """This node's topics in one state of the master."""

    state: MasterState
    published: frozenset[str]
    subscribed: frozenset[str]


class Master:
    """Follows one master for one node.

    ``seen`` is called on its thread after each read, with None once the master is unreachable. ``is_dead`` returns
    whether a service's server is known to be dead, so that Midspan may register its name. ``trouble`` is why the master
    is unreachable, else ""; ``looked`` is ``time.monotonic()`` before the latest read; ``simulated``: its nodes run on
    ``/clock``, by the parameter ``/use_sim_time`` at the time of joining.
    """

    def __init__(
        self, uri: str, node: Ros1Node, daemon: str, ledger: Ledger, period: float, seen: Seen, lost_name: Lost,
        is_dead: Callable[[Registration], bool], *, simulated: bool,
    ) -> None:  # fmt: skip
        self.uri = uri
        self.trouble = ""
        self.simulated = self._simulated = simulated
        self.looked = float("-inf")
        self._node, self._daemon, self._ledger = node, daemon, ledger
        self._period, self._seen, self._lost_name, self._is_dead = period, seen, lost_name, is_dead
        self._evicted = False
        self._client = XmlRpcClient(uri, _TIMEOUT)
        self._reader = MasterReader(self._client, node.name)
        self._run_id: str | None = None
        self._own: _Own | None = None
        self._failures = 0
        self._answered = time.monotonic()
        self._refused: set[str] = set()
        self._ended: set[str] = set()
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="midspan-ros1-master", daemon=True)

    def start(self) -> None:
        """Start following; the master may be unreachable."""
        self._wake.set()
        self._thread.start()

    def wake(self) -> None:
        """Read the master again at once."""
        self._wake.set()

    def doubt(self, service: str) -> None:
        """Look up a service's address again in the next read, as the known one failed."""
        self._reader.doubt(service)

    def evicted(self) -> None:
        """Stop registering: another node has this name, and the two would shut each other down in turn."""
        self._evicted = True

    def presence(self) -> NodeEntry:
        """Return this node's entry."""
        node = self._node
        return NodeEntry(self._ledger.owner, self._daemon, node.name, node.uri, os.getpid(), node.port)

    def stop(self) -> None:
        """Unregister everything that the master lists for this node."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(_STOP_TIMEOUT)
        client = XmlRpcClient(self.uri, _STOP_TIMEOUT)
        with contextlib.closing(client):
            try:
                entry = self.presence()
                state = MasterReader(client, entry.node).read()
                for batch in _batches(removal_calls(state, [entry])):
                    client.calls(batch)
                self._ledger.remember(None)
            except Ros1Error as err:
                _log.info("not unregistered, the master is unreachable: %s", err)

    def _loop(self) -> None:
        while True:
            self._wake.wait(_RETRY if self._failures == 1 else self._reader.pause(self._period))
            self._wake.clear()
            if self._stopping.is_set():
                self._client.close()
                return
            try:
                state = self._turn()
            except Ros1Error as err:
                self._failed(err)
            except Exception as err:
                _log.exception("the state of the ROS 1 master cannot be used")
                self._failed(Ros1ProtocolError(f"{self.uri} has a state that cannot be used: {type(err).__name__}"))
            else:
                self._failures, self.trouble, self._answered = 0, "", time.monotonic()
                self._seen(state)

    def _turn(self) -> MasterState:
        self.looked = time.monotonic()
        state = self._reader.read()
        if state.run != self._run_id:
            self._join(state)
            self.looked = time.monotonic()
            state = self._reader.read()
            self._run_id = state.run
        self._guard_name(state)
        calls = [] if self._evicted else self._missing(state)
        self._refused &= {_what(call) for call in calls}
        for batch in _batches(calls):
            if self._stopping.is_set():
                break
            self._check(batch, self._client.calls(batch))
        else:
            self._ended.clear()
        if calls:
            self.looked = time.monotonic()
            state = self._reader.read()
        return state

    def _failed(self, err: Ros1Error) -> None:
        self._failures += 1
        refused = isinstance(err, UnreachableError) and err.refused and self._failures >= _FAILURES
        if refused or time.monotonic() - self._answered > _PATIENCE:
            if not self.trouble:
                level = logging.INFO if self._run_id is None else logging.WARNING
                _log.log(level, "the ROS 1 master is unreachable: %s", err)
            self.trouble = str(err)
            self._run_id = None
            self._seen(None)

    # -- joining -------------------------------------------------------------------------------------------------------

    def _join(self, state: MasterState) -> None:
        entry = self.presence()
        dead = [e for e in self._ledger.predecessors(state, entry) if not is_alive(entry.node, e)]
        for batch in _batches(removal_calls(state, dead)):
            self._client.calls(batch)
        dead_uris = {e.uri for e in dead}
        for _ in range(_SPARE_NAMES):
            name = self._free_name(state, dead_uris)
            if name != self._node.name:
                _log.info("the name %s is taken on this ROS 1 network; this node is %s", self._node.name, name)
                self._node.name = name
                self._reader.caller = name
            # Another daemon may be choosing a name, too: the one that then reads the other's entry chooses another
            # name.
            entry = self.presence()
            self._client.calls([("setParam", (entry.node, entry.parameter, entry.as_dict()))])
            state = self._reader.read()
            if self._free_name(state, dead_uris) == name:
                break
        self._ledger.remember(self.presence())
        self._agree_on_the_clock()
        _log.info("joined the ROS 1 network %s as %s", state.network, name)

    def _agree_on_the_clock(self) -> None:
        """Make new nodes use ``/clock`` in a simulated run; otherwise read whether they do."""
        if self._simulated:
            self._client.calls([("setParam", (self._node.name, SIM_TIME, True))])
        else:
            (self.simulated,) = (bool(v) for v in self._client.calls([("getParam", (self._node.name, SIM_TIME))]))

    def _free_name(self, state: MasterState, dead: set[str]) -> str:
        """Return this node's name, or a variant if a live node has it, which the master would shut down."""
        first = self._node.name
        second = f"{first}_{re.sub(r'[^A-Za-z0-9_]', '_', self._daemon)}"
        for name in (first, second, *(f"{second}_{n}" for n in range(2, 2 + _SPARE_NAMES))):
            entries = [NodeEntry.parse(entry) for entry in state.presence.values()]
            uris = {state.uris.get(name), *(e.uri for e in entries if e is not None and e.node == name)}
            holders = {u for u in uris if u and u != self._node.uri and u not in dead}
            if not any(self._answers(holder) for holder in holders):
                return name
        return f"{second}_{os.getpid()}"

    def _guard_name(self, state: MasterState) -> None:
        name = self._node.name
        uri = state.uris.get(name, self._node.uri)
        if uri != self._node.uri and not self._evicted and self._answers(uri):
            self.evicted()
            self._lost_name(f"another node, at {uri}, took the name {name} on this ROS 1 network")

    def _answers(self, uri: str) -> bool:
        try:
            ask(uri, 1.0, "getPid", self._node.name)
        except Ros1Error:
            return False
        return True

    # -- registrations -------------------------------------------------------------------------------------------------

    def _missing(self, state: MasterState) -> list[Call]:
        """Return the calls that correct this node's registrations."""
        name, uri = self._node.name, self._node.uri
        self._ended |= self._node.take_removed()
        published, subscribed = self._node.publications(), self._node.subscriptions()
        if self._own is None or self._own.state is not state:
            ends = (state.publishers, state.subscribers)
            self._own = _Own(
                state, *(frozenset(r.topic for r in end if (r.node, r.uri) == (name, uri)) for end in ends)
            )
        _, has_published, has_subscribed = self._own
        # A publication that ended and was created again between two reads is unregistered and registered: a rospy
        # subscriber whose connection broke reconnects only when the master reports a publisher that was not listed.
        standing = has_published & published.keys() - self._ended
        calls: list[Call] = [
            *(("unregisterPublisher", (name, t, uri)) for t in has_published - standing),
            *(("unregisterSubscriber", (name, t, uri)) for t in has_subscribed - subscribed.keys()),
            *(("registerPublisher", (name, t, published[t], uri)) for t in published.keys() - standing),
            *(("registerSubscriber", (name, t, subscribed[t], uri)) for t in subscribed.keys() - has_subscribed),
            *self._service_calls(state),
        ]
        entry = self.presence()
        if NodeEntry.parse(state.presence.get(entry.key)) != entry:
            calls.append(("setParam", (name, entry.parameter, entry.as_dict())))
        return calls

    def _service_calls(self, state: MasterState) -> list[Call]:
        """Return the calls for services: a master has one server per name, and the last to register replaces it."""
        name, uri, wanted = self._node.name, self._node.uri, self._node.services()
        has = {link.topic: link.uri for link in state.servers if link.node == name}
        taken = {link.topic for link in state.servers if link.node != name and not self._is_dead(link)}
        return [
            *(("unregisterService", (name, s, a)) for s, a in has.items() if a and wanted.get(s) != a),
            *(("registerService", (name, s, a, uri)) for s, a in wanted.items() if has.get(s) != a and s not in taken),
        ]

    def _check(self, calls: Sequence[Call], values: Sequence[object]) -> None:
        for call, value in zip(calls, values, strict=True):
            action = _what(call)
            if value is None and action not in self._refused:
                _log.warning("the master rejects %s", action)
                self._refused.add(action)
            elif value is not None:
                self._refused.discard(action)


def _what(call: Call) -> str:
    method, params = call
    return f"{method} {params[1]}"


def _batches(calls: Sequence[Call]) -> Iterator[Sequence[Call]]:
    for at in range(0, len(calls), _BATCH):
        yield calls[at : at + _BATCH]

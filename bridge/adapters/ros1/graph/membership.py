"""This node on a ROS 1 network: its name, its entry on the master, and what its predecessors left there."""

from __future__ import annotations

import logging
import os
import re

from bridge.adapters.ros1.graph.presence import Ledger, NodeEntry, others, pid_of, pids_of, removal_calls
from bridge.adapters.ros1.graph.registrations import batches
from bridge.adapters.ros1.graph.sim_time import SimTime
from bridge.adapters.ros1.graph.state import NAMESPACE, MasterReader, MasterState
from bridge.adapters.ros1.namespaces import delete_empty, is_empty
from bridge.adapters.ros1.node.node import Ros1Node
from bridge.adapters.ros1_peers import XmlRpcClient

_log = logging.getLogger(__name__)

_SPARE_NAMES = 9


class Membership:
    """Joins the network of a master, and leaves it. Used on one thread.

    Attributes:
        sim_time: the network's parameter ``/use_sim_time``.
    """

    def __init__(
        self, node: Ros1Node, daemon: str, ledger: Ledger, client: XmlRpcClient, reader: MasterReader, *,
        simulated: bool,
    ) -> None:  # fmt: skip
        self._node, self._daemon, self._ledger = node, daemon, ledger
        self._client, self._reader = client, reader
        self.sim_time = SimTime(node, client, wanted=simulated)

    def entry(self) -> NodeEntry:
        """Return the presence entry of this node."""
        node = self._node
        return NodeEntry(
            self._ledger.owner, self._daemon, node.name, node.uri, os.getpid(), node.port, self.sim_time.wanted
        )

    def join(self, state: MasterState) -> None:
        """Join the network of a master with this state: remove dead predecessors, choose a name, and set the entry."""
        entry = self.entry()
        predecessors = self._ledger.predecessors(state, entry)
        pids = pids_of(entry.node, {e.uri for e in predecessors})
        dead = [e for e in predecessors if pids[e.uri] != e.pid]
        for batch in batches(removal_calls(state, dead)):
            self._client.calls(batch)
        dead_uris = {e.uri for e in dead}
        for _ in range(_SPARE_NAMES):
            name = self._free_name(state, dead_uris)
            if name != self._node.name:
                _log.info("the name %s is in use on this ROS 1 network; this node is %s", self._node.name, name)
                self._node.name = name
                self._reader.caller = name
            # Another daemon may be choosing the same name at the same time; a daemon that then reads the other's entry
            # chooses another name.
            entry = self.entry()
            self._client.calls([("setParam", (entry.node, entry.parameter, entry.as_dict()))])
            state = self._reader.read()
            if self._free_name(state, dead_uris) == name:
                break
        self.sim_time.join(others(state, entry), predecessor=any(e.simulated for e in dead))
        self._ledger.remember(self.entry())
        _log.info("joined the ROS 1 network %s as %s", state.network, name)

    def is_listed(self, state: MasterState) -> bool:
        """Return whether a master with this state has the entry of this node."""
        entry = self.entry()
        return NodeEntry.parse(state.presence.get(entry.key)) == entry

    def rejoin(self, state: MasterState) -> None:
        """Set the entry and the parameter again on a master that has lost them."""
        entry = self.entry()
        self._client.calls([("setParam", (entry.node, entry.parameter, entry.as_dict()))])
        self.sim_time.join(others(state, entry), predecessor=False)

    def leave(self, client: XmlRpcClient) -> None:
        """Remove everything that the master lists for this node."""
        entry = self.entry()
        state = MasterReader(client, entry.node).read()
        for batch in batches(removal_calls(state, [entry])):
            client.calls(batch)
        self.sim_time.leave(client)

    def release(self, client: XmlRpcClient) -> None:
        """Remove what the last node removes; call this after `leave`. May last a second, until other nodes respond."""
        self.sim_time.release(client)
        (tree,) = client.calls([("getParam", (self._node.name, NAMESPACE))])
        if is_empty(tree):
            delete_empty(client, self._node.name, [NAMESPACE])
        self._ledger.remember(None)

    def responds(self, uri: str) -> bool:
        """Return whether a node responds at this URI; see `pid_of`."""
        return pid_of(self._node.name, uri) is not None

    def _free_name(self, state: MasterState, dead: set[str]) -> str:
        """Return this node's name, or a variant if a live node has it, as the master would shut that node down."""
        first = self._node.name
        second = f"{first}_{re.sub(r'[^A-Za-z0-9_]', '_', self._daemon)}"
        entries = [e for e in map(NodeEntry.parse, state.presence.values()) if e is not None]
        holders: dict[str, set[str]] = {}
        for name in (first, second, *(f"{second}_{n}" for n in range(2, 2 + _SPARE_NAMES))):
            uris = {state.uris.get(name, ""), *(e.uri for e in entries if e.node == name)}
            holders[name] = uris - {"", self._node.uri} - dead
        if not holders[first]:
            return first
        pids = pids_of(first, set().union(*holders.values()))
        free = (name for name, uris in holders.items() if all(pids[uri] is None for uri in uris))
        return next(free, f"{second}_{os.getpid()}")

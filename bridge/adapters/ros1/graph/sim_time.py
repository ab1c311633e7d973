"""``/use_sim_time`` on a master: Midspan sets it for a simulated run, and takes it back after the last one.

`SET_BY` exists on the master while `SIM_TIME` has the value that Midspan has set, because both outlive a killed
process and end with the master. The nodes of all daemons share it: one node may take back what another has set.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from bridge.adapters.ros1.graph.presence import NodeEntry, any_alive
from bridge.adapters.ros1.graph.state import PRESENCE
from bridge.adapters.ros1.node.node import Ros1Node
from bridge.adapters.ros1.node.slave import ParameterUpdate
from bridge.adapters.ros1_peers import Call, Ros1Error, XmlRpcClient

_log = logging.getLogger(__name__)

SIM_TIME = "/use_sim_time"
"""The parameter by which ROS 1 nodes, as they start, decide to run on ``/clock`` (wiki.ros.org/Clock)."""

SET_BY = "/midspan/use_sim_time"
"""``{uri, before}``: the XML-RPC address of the node that set `SIM_TIME`, and a list of the value that it replaced."""

_JOIN_SECONDS, _RELEASE_SECONDS = 2.5, 1.0
"""Seconds for the answers of all other nodes; a worker has few seconds to stop."""

_MAX_UPDATES = 100
"""Maximum number of updates that wait for the next read of the master."""


class SimTime:
    """The parameter, for one node. Used on one thread, except `on_parameter`. Methods raise `Ros1Error`.

    Attributes:
        wanted: whether this node runs on ``/clock``, so that the network's nodes should, too.
        simulated: whether nodes that start now run on ``/clock``, according to the parameter.
    """

    def __init__(self, node: Ros1Node, client: XmlRpcClient, *, wanted: bool) -> None:
        self._node, self._client = node, client
        self.wanted = self.simulated = wanted
        self._set_by: Any = None
        self._updates: deque[ParameterUpdate] = deque(maxlen=_MAX_UPDATES)

    def on_parameter(self, update: ParameterUpdate) -> bool:
        """Handle an update of a parameter; return whether it is this one. Thread-safe."""
        if update.key.rstrip("/") != SIM_TIME:
            return False
        self._updates.append(update)
        return True

    def join(self, others: Iterable[NodeEntry], *, predecessor: bool) -> None:
        """Set the parameter if it is wanted; else take it back for a dead ``predecessor`` that ran on ``/clock``."""
        self._updates.clear()
        self._client.calls([("subscribeParam", (self._node.name, self._node.uri, SIM_TIME))])
        value, self._set_by = self._read(self._client)
        if self.wanted and not value:
            self._set(value)
            value = True
        elif predecessor and not self.wanted and not self._needed(others, _JOIN_SECONDS):
            self._take_back(self._client)
            value, self._set_by = self._read(self._client)
        self.simulated = bool(value)

    def _set(self, before: Any) -> None:
        me = self._node.name
        self._set_by = {"uri": self._node.uri, "before": [] if before is None else [before]}
        # a node that is notified of the value must find the new address, else it takes this node for a program
        self._client.calls([("setParam", (me, SET_BY, self._set_by)), ("setParam", (me, SIM_TIME, True))])

    def refresh(self) -> None:
        """Read the parameter again if another program has set it; Midspan does not take back that program's value.

        If another node has just taken it back, this node sets it again.
        """
        updates = [self._updates.popleft() for _ in range(len(self._updates))]
        if not updates:
            return
        try:
            value, set_by = self._read(self._client)
            self._follow(value, set_by, updates)
        except Ros1Error:
            self._updates.extendleft(reversed(updates))
            raise

    def _follow(self, value: Any, set_by: Any, updates: Sequence[ParameterUpdate]) -> None:
        me = self._node.name
        is_set = value is not True or not all(update.repeated for update in updates)
        if value is None and set_by is None and self.wanted:
            self._set(value)
            value, set_by = True, self._set_by
        elif is_set and set_by is not None and set_by == self._set_by and not self._is_shared():
            _log.info("%s was set to %s by another program, and will not be reset", SIM_TIME, value)
            self._client.calls([("deleteParam", (me, SET_BY))])
            set_by = None
        self.simulated, self._set_by = bool(value), set_by

    def _is_shared(self) -> bool:
        """Return whether another node runs on ``/clock``, which may have set the parameter at the same time."""
        (presence,) = self._client.calls([("getParam", (self._node.name, PRESENCE))])
        return any(entry.simulated and entry.uri != self._node.uri for entry in _entries(presence))

    def leave(self, client: XmlRpcClient) -> None:
        """Stop following the parameter."""
        client.calls([("unsubscribeParam", (self._node.name, self._node.uri, SIM_TIME))])

    def release(self, client: XmlRpcClient) -> None:
        """Take the parameter back unless another node needs it; call this after the removal of the own entry.

        So of two nodes that leave at the same time, one finds no other. Waits up to `_RELEASE_SECONDS` for the others.
        """
        if not self.wanted:
            return
        (presence,) = client.calls([("getParam", (self._node.name, PRESENCE))])
        if not self._needed(_entries(presence), _RELEASE_SECONDS):
            self._take_back(client)

    def _needed(self, others: Iterable[NodeEntry], seconds: float) -> bool:
        return any_alive(self._node.name, [entry for entry in others if entry.simulated], seconds)

    def _read(self, client: XmlRpcClient) -> list[Any]:
        return client.calls([("getParam", (self._node.name, name)) for name in (SIM_TIME, SET_BY)])

    def _take_back(self, client: XmlRpcClient) -> None:
        me = self._node.name
        match self._read(client):
            case [value, {"before": [*before]}]:
                undo: Call = ("setParam", (me, SIM_TIME, before[0])) if before else ("deleteParam", (me, SIM_TIME))
                if value is True:
                    _log.info("%s is reset, since no Midspan node runs on /clock any longer", SIM_TIME)
                client.calls([*([undo] if value is True else []), ("deleteParam", (me, SET_BY))])


def _entries(presence: Any) -> Iterator[NodeEntry]:
    """Yield the valid entries of a master's presence parameter."""
    yield from filter(None, map(NodeEntry.parse, presence.values() if isinstance(presence, dict) else ()))

"""A master that listens: its API over XML-RPC, its state file, its calls to nodes, and the removal of dead nodes."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable
from pathlib import Path

from bridge.adapters.ros1.master import saved
from bridge.adapters.ros1.master.api import MasterApi
from bridge.adapters.ros1.master.liveness import Liveness, Nodes
from bridge.adapters.ros1.master.node_calls import NodeCalls
from bridge.adapters.ros1.master.rosout import AGGREGATED, NODE, RosoutNode, is_elsewhere
from bridge.adapters.ros1.xmlrpc import XmlRpcServer
from bridge.adapters.ros1.xmlrpc_request import Limits
from bridge.concurrency import DelayedCalls

_log = logging.getLogger("midspan.ros1.master")

_LIMITS = Limits(connections=2048, body=32 * 2**20, buffered=128 * 2**20, values=1_000_000)
"""``rosparam load`` sends a whole file, with a robot's description, in one request."""

_QUICK = (
    "registerPublisher", "unregisterPublisher", "registerSubscriber", "unregisterSubscriber", "registerService",
    "unregisterService", "lookupService", "lookupNode", "setParam", "hasParam", "searchParam", "getUri", "getPid",
)  # fmt: skip
"""Methods with short replies, unlike ``getParam`` and ``getSystemState``, for example."""

_DISTRIBUTION = {"/rosdistro": "noetic\n", "/rosversion": "1.16.0\n"}
"""Parameters that roscore sets, with the values of its last release."""

_ROSCORE = "/roslaunch"
"""The node that sets roscore's parameters."""

_RESPAWN_SECONDS = 1.0
"""Seconds after the end of the node ``/rosout`` until this master starts its own, as roscore does."""


class EmbeddedMaster:
    """A ROS 1 master in this process.

    Args:
        address: the address to listen on, with ``port``.
        uri: the master's address for nodes; by default it contains the address that the master listens on.
        state: the file for the master's state, None to keep no state.
        purge: seconds without an answer after which a dead node is removed; 0 for never.
        shut_down: called when a client requests ``shutdown``; None to refuse such requests.
        rosout: whether the master runs the node ``/rosout`` while no other program does.

    Attributes:
        uri: the master's address.
        api: the master's registrations and parameters.

    Raises:
        OSError: the master cannot listen on this address and port.
    """

    def __init__(
        self, address: str, port: int, uri: str = "", *, state: Path | None = None, purge: float = 0.0,
        shut_down: Callable[[], None] | None = None, rosout: bool = True,
    ) -> None:  # fmt: skip
        self.calls = NodeCalls(lambda subscriber, key: self.api.drop_param_subscriber(subscriber, key))
        self._writer: saved.StateWriter | None = None
        self.api = MasterApi("", self.calls, self._on_change, shut_down)
        self._server = XmlRpcServer(
            self.api.methods, address, port, name="midspan-ros1-master", limits=_LIMITS, quick=_QUICK
        )
        host = f"[{address}]" if ":" in address else address
        self.uri = self.api.uri = uri or f"http://{host}:{self._server.port}/"
        self._address, self._state, self._has_rosout = address, state, rosout
        self._rosout: RosoutNode | None = None
        self._rosout_starts = DelayedCalls("midspan-ros1-rosout")
        self._respawns = False
        self._liveness = Liveness(self.nodes, self.api.set_reachable, self._on_dead, purge)

    def start(self) -> None:
        """Restore the state, and start serving."""
        restored: Nodes = {}
        if self._state is not None:
            if saved.load(self._state, self.api):
                nodes = self.api.registrations.nodes
                restored = {name: node.api for name, node in nodes.items() if node.reachable}
                _log.info("restored %d nodes and the parameters from %s", len(nodes), self._state)
            self._writer = saved.StateWriter(self._state, self.api)
            self._writer.start()
        for name, value in {"/run_id": str(uuid.uuid4()), **_DISTRIBUTION}.items():
            if not self.api.parameters.has(name):
                self.api.set_param(_ROSCORE, name, value)
        self._server.start()
        if self._has_rosout:
            self._start_rosout()
        self.api.report_all()
        self._liveness.start(restored)

    def _start_rosout(self) -> None:
        stale = self.nodes().get(NODE)
        if stale is not None and not is_elsewhere(self.api):
            # a killed master's node; another node may have its port now, and must not be shut down
            self.api.remove_dead(NODE, stale)
        self._respawn_rosout()
        self._respawns = True

    def _respawn_rosout(self) -> None:
        """Run the node ``/rosout`` in place of this master's previous one, unless the name is registered."""
        if NODE in self.nodes():
            return
        if self._rosout is not None:
            self._rosout.close()
            self._rosout = None
        try:
            self._rosout = RosoutNode(self.api, self.uri, self._address)
        except OSError as err:
            _log.warning("%s is not published: %s", AGGREGATED, err.strerror)
        else:
            self._rosout.start()

    def nodes(self) -> Nodes:
        """Return names and addresses of the registered nodes."""
        with self.api.lock:
            return {name: node.api for name, node in self.api.registrations.nodes.items()}

    def close(self) -> None:
        """Stop serving, and write the state."""
        self._rosout_starts.close()
        if self._rosout is not None:
            self._rosout.close()
        self._server.close()
        if self._writer is not None:  # before the rest, because a stopping daemon waits only a second
            self._writer.close()
        self._liveness.close()
        self.calls.close()

    def _on_change(self) -> None:
        if self._writer is not None:
            self._writer.changed()
        if self._respawns and NODE not in self.api.registrations.nodes:
            self._rosout_starts.after(_RESPAWN_SECONDS, self._respawn_rosout, once=True)

    def _on_dead(self, node: str, api: str) -> None:
        if self.api.remove_dead(node, api):
            self.calls.drop(api)

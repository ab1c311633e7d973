"""The thread that calls the master: reads its graph, and maintains this node's registrations.

A rospy node registers only once. Midspan compares its node's wanted registrations with the master's state at each
read, and corrects the differences. Therefore a master that was restarted, or that lost the registrations, has them
again after one read.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable

from bridge.adapters.ros1.graph.membership import Membership
from bridge.adapters.ros1.graph.presence import Ledger, NodeEntry
from bridge.adapters.ros1.graph.prompts import Prompts
from bridge.adapters.ros1.graph.registrations import NodeRegistrations, batches
from bridge.adapters.ros1.graph.state import MasterReader, MasterState, Registration
from bridge.adapters.ros1.node.node import Ros1Node
from bridge.adapters.ros1.node.slave import ParameterUpdate
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.adapters.ros1_peers import ExhaustedError, Ros1Error, Ros1ProtocolError, UnreachableError, XmlRpcClient

_log = logging.getLogger(__name__)

_TIMEOUT = 2.0
_STOP_TIMEOUT = 0.7
_RETRY = 0.1
_FAILURES = 2
_UNREACHABLE_SECONDS = 5.0
"""Seconds without a response after which the master counts as unreachable; on a busy machine it may respond late.

If it refuses connections, it counts as unreachable earlier. In both cases at least `_FAILURES` reads in a row have
failed, because this process may have been suspended during one of them.
"""

Seen = Callable[[MasterState | None], None]
Failed = Callable[[str], None]


class Master:
    """Follows one master for one node.

    ``seen`` is called on its thread after each read, with None while the master is unreachable; ``failed`` with the
    reason if the thread cannot continue, or another node has this node's name. ``is_dead`` returns whether a service's
    server is known to be dead, so that Midspan may register the service. ``pool`` calls nodes.
    ``trouble`` is why the master is unreachable, else ""; ``polled_at`` is ``time.monotonic()`` before the latest read.
    """

    def __init__(
        self, uri: str, node: Ros1Node, daemon: str, ledger: Ledger, period: float, seen: Seen, failed: Failed,
        is_dead: Callable[[Registration], bool], pool: PeerPool, *, simulated: bool,
    ) -> None:  # fmt: skip
        self.uri = uri
        self.trouble = ""
        self.polled_at = float("-inf")
        self._node = node
        self._period, self._seen, self._give_up = period, seen, failed
        self._name_lost = self._left = False
        self._client = XmlRpcClient(uri, _TIMEOUT)
        self._reader = MasterReader(self._client, node.name)
        self._membership = Membership(node, daemon, ledger, self._client, self._reader, simulated=simulated)
        prompts = Prompts(pool, lambda: node.name, self.wake)
        self._registrations = NodeRegistrations(node, is_dead, prompts)
        self._run_id: str | None = None
        self._failures = 0
        self._answered_at = time.monotonic()
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-ros1-master", daemon=True)

    @property
    def simulated(self) -> bool:
        """Whether nodes of the master that start now run on ``/clock``, according to ``/use_sim_time``."""
        return self._membership.sim_time.simulated

    def start(self) -> None:
        """Start following; the master may be unreachable."""
        self._wake.set()
        self._thread.start()

    def wake(self) -> None:
        """Read the master again at once."""
        self._wake.set()

    def recheck_service(self, service: str) -> None:
        """Look up a service's address again in the next read, because the known address failed."""
        self._reader.recheck_service(service)

    def stop_registering(self) -> None:
        """Stop registering, because another node has this name, and the two would shut each other down in turn."""
        self._name_lost = True

    def on_parameter(self, update: ParameterUpdate) -> bool:
        """Handle an update of a parameter; return whether the master's thread has subscribed to it."""
        subscribed = self._membership.sim_time.on_parameter(update)
        if subscribed:
            self._wake.set()
        return subscribed

    def presence(self) -> NodeEntry:
        """Return the presence entry of this node, which is a parameter on the master."""
        return self._membership.entry()

    def stop(self) -> None:
        """Unregister everything that the master lists for this node."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(_STOP_TIMEOUT)
        self._left = self._call_last(self._membership.leave)

    def release(self) -> None:
        """Remove what the last of Midspan's nodes removes. Call this last: it may wait for other hosts for a second."""
        if self._left:
            self._call_last(self._membership.release)

    def _call_last(self, action: Callable[[XmlRpcClient], None]) -> bool:
        """Run an action with a client for a stopping node; return whether the master responds."""
        with contextlib.closing(XmlRpcClient(self.uri, _STOP_TIMEOUT)) as client:
            try:
                action(client)
            except Ros1Error as err:
                _log.info("not unregistered, because the master is unreachable: %s", err)
                return False
        return True

    def _run(self) -> None:
        try:
            self._follow()
        except Exception as err:  # of the edge, for example because the system is out of threads
            _log.exception("following the ROS 1 master failed")
            self._give_up(f"following the ROS 1 master failed: {type(err).__name__}: {err}")

    def _follow(self) -> None:
        while True:
            self._wake.wait(_RETRY if self._failures == 1 else self._reader.pause(self._period))
            self._wake.clear()
            if self._stopping.is_set():
                self._client.close()
                return
            try:
                state = self._poll()
            except Ros1Error as err:
                self._failed(err)
            except Exception as err:
                _log.exception("the state of the ROS 1 master cannot be used")
                self._failed(Ros1ProtocolError(f"{self.uri} has a state that cannot be used: {type(err).__name__}"))
            else:
                self._failures, self.trouble, self._answered_at = 0, "", time.monotonic()
                self._seen(state)

    def _poll(self) -> MasterState:
        self.polled_at = time.monotonic()
        state = self._reader.read()
        if state.run != self._run_id:
            self._membership.join(state)
            self.polled_at = time.monotonic()
            state = self._reader.read()
            self._run_id = state.run
        elif not self._name_lost and not self._membership.is_listed(state):
            # a restarted master may have the same run id and process id, for example in a container
            self._membership.rejoin(state)
            self.polled_at = time.monotonic()
            state = self._reader.read()
        self._membership.sim_time.refresh()
        self._check_name(state)
        calls = [] if self._name_lost else self._registrations.corrections(state, self.presence())
        for batch in batches(calls):
            if self._stopping.is_set():
                break
            self._registrations.on_replies(batch, self._client.calls(batch))
        else:
            self._registrations.clear_ended()
        if calls:
            self.polled_at = time.monotonic()
            state = self._reader.read()
        return state

    def _failed(self, err: Ros1Error) -> None:
        self._failures += 1
        refused = isinstance(err, UnreachableError) and err.refused
        late = time.monotonic() - self._answered_at > _UNREACHABLE_SECONDS
        if self._failures >= _FAILURES and (refused or late):
            if not self.trouble:
                level = logging.INFO if self._run_id is None else logging.WARNING
                _log.log(level, "the ROS 1 master is unreachable: %s", err)
            self.trouble = str(err)
            self._run_id = None
            self._seen(None)

    def _check_name(self, state: MasterState) -> None:
        uri = state.uris.get(self._node.name, self._node.uri)
        if uri == self._node.uri or self._name_lost:
            return
        with contextlib.suppress(ExhaustedError):  # the next read checks it again
            if self._membership.responds(uri):
                self.stop_registering()
                self._give_up(f"another node, at {uri}, took the name {self._node.name} on this ROS 1 network")

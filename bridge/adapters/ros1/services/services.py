"""The services of a ROS 1 graph: native servers, clients of them, and this node's servers.

A master lists only a service's node and address. Its type and md5 sum are in the server's connection header, so each
new server is probed once. Clients are not listed, because they do not appear on the graph.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping

from typing_extensions import override

from bridge.adapters.ros1.graph.probe import EndUpdater, Facts, Ros1Context
from bridge.adapters.ros1.graph.state import MasterState, Registration
from bridge.adapters.ros1.handshake import Header, connect_service
from bridge.adapters.ros1.services.caller import Ros1Caller
from bridge.adapters.ros1.services.server import ServiceServers
from bridge.adapters.ros1_peers import DeadlineSocket, ExhaustedError, Ros1Error
from bridge.hub.wire.qos import Qos
from bridge.messages.transcode.conversion import SideType
from bridge.routing.edge import Endpoint, Kind, MadeBy

_OF_EVERY_NODE = ("/get_loggers", "/set_logger_level")
"""Services of every node. A dead node leaves them on the master, too, so they are not reported."""

_CHECK_PERIOD = 2.0


class Ros1Services(EndUpdater[Ros1Caller]):
    """The services of one edge; ``wake`` has the master read, ``recheck`` has a service's address looked up again."""

    def __init__(self, context: Ros1Context, wake: Callable[[], None], recheck: Callable[[str], None]) -> None:
        super().__init__(context, self._handshake, "server")
        self._recheck = recheck
        self._check_due = 0.0
        self.servers = ServiceServers(context, wake)

    def stop(self) -> None:
        self.close()
        self.servers.close()

    def on_master_read(self, state: MasterState | None) -> None:
        """Adopt the master's state; called on the master's thread."""
        node = self._context.node()
        self.update(frozenset(s for s in state.servers if s.node != node) if state is not None else frozenset())
        self._check_rivals()

    def _check_rivals(self) -> None:
        """Check that native servers of the same names are alive, because nothing else detects their exit."""
        if time.monotonic() < self._check_due:
            return
        self._check_due = time.monotonic() + _CHECK_PERIOD
        known = self.prober.facts().keys()
        for link in self._rivals():
            if link in known:
                self.prober.check(link)

    def _rivals(self) -> list[Registration]:
        ours = frozenset(self.servers.names())
        return sorted(link for link in self._peers if link.topic in ours) if ours else []

    def endpoints(self, state: MasterState) -> Iterator[Endpoint]:
        """Yield the other nodes' servers."""
        node, facts = self._context.node(), self.prober.facts()
        midspans = {entry.get("node") for entry in state.presence.values()}
        for link in state.servers:
            if link.node != node:
                yield _endpoint(link, facts.get(link), midspan=link.node in midspans)

    def connected(self) -> frozenset[Registration]:
        """Return the servers to which a caller is connected."""
        return frozenset(link for end in self._current_ends() for link in end.connected)

    def is_gone(self, link: Registration) -> bool:
        """Return whether a server is known to be dead although the master still lists it."""
        return self.prober.is_gone(link)

    def warnings(self) -> Iterator[str]:
        """Yield servers that do not announce their type, and hub services with a native rival."""
        for link, failure in sorted(self.prober.failures().items()):
            if not link.topic.endswith(_OF_EVERY_NODE):
                yield f"{link.topic}: its server {link.node} does not announce its type: {failure}"
        for link in self._rivals():
            if not self.is_gone(link):
                yield f"{link.topic}: {link.node} serves it on ROS 1 itself, so the hub's service is not offered there"

    def _handshake(self, caller: str, uri: str, service: str, seconds: float) -> tuple[DeadlineSocket, Header]:
        try:
            return connect_service(caller, uri, service, seconds, md5sum="*", probe="1")
        except ExhaustedError:
            raise
        except Ros1Error:
            self._recheck(service)
            raise

    def _on_outdated(self, link: Registration, failure: str) -> None:
        self._recheck(link.topic)
        self.prober.drop_facts(link, failure)

    def caller(self, name: str, side_type: SideType) -> Ros1Caller:
        """Return a client of the native server of a service."""
        return self._add(Ros1Caller(self._context, name, side_type, self._on_outdated, self._remove))

    @override
    def _notify(self, end: Ros1Caller, known: Mapping[Registration, Facts]) -> None:
        natives = [(link, facts) for link, facts in known.items() if facts.native]
        end.follow(natives[-1][0] if natives and natives[-1][1].fits(end.md5) else None)


def _endpoint(link: Registration, facts: Facts | None, *, midspan: bool) -> Endpoint:
    if midspan or (facts is not None and not facts.native):
        made_by = MadeBy.MIDSPAN
    else:
        made_by = MadeBy.UNKNOWN if facts is None else MadeBy.NATIVE
    name = f"server {link.topic} {link.node} {link.uri}"
    type_, md5 = (facts.type, facts.md5) if facts is not None else ("", "")
    return Endpoint(name, Kind.SERVER, link.topic, type_, Qos(), made_by, link.node, md5)

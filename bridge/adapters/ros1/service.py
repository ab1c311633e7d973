"""The services of a ROS 1 graph: which servers there are, calling them, and serving ours.

A master names a service's node and address alone. Its type and md5 sum stand in the header that its server answers
with, so each new one is asked once. Clients leave no trace on the graph: there are none to be shown.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

from bridge.adapters.base import Endpoint, Kind, MadeBy
from bridge.adapters.ros1.deadline import DeadlineSocket
from bridge.adapters.ros1.errors import ExhaustedError, Ros1Error
from bridge.adapters.ros1.graph import Link, Look
from bridge.adapters.ros1.handshake import Header, connect_service
from bridge.adapters.ros1.intake import Intake
from bridge.adapters.ros1.lanes import Lanes
from bridge.adapters.ros1.probe import Facts, Prober
from bridge.adapters.ros1.service_caller import Caller
from bridge.adapters.ros1.service_server import Servers
from bridge.hub.call import Abandon, Done
from bridge.hub.qos import Qos
from bridge.messages.conversion import SideType

_OF_EVERY_NODE = ("/get_loggers", "/set_logger_level")
"""A dead node leaves these on the master too; nobody misses them."""

_ANY_MD5 = ("*", "")
_CHECK_PERIOD = 2.0


class Services:
    """The services of one edge.

    Args:
        lanes: threads for conversations.
        node: our node's name now.
        origin: the daemon's name.
        found: called when something became known of a server.
        wake: called to have the master looked at.
        doubt: called with the name of a service that is not where the master said.
        limit: bytes of the longest request and reply.
    """

    def __init__(
        self,
        lanes: Lanes,
        node: Callable[[], str],
        origin: str,
        *,
        found: Callable[[], None],
        wake: Callable[[], None],
        doubt: Callable[[str], None],
        limit: int,
    ) -> None:
        self._lanes, self._node, self._found, self._doubt, self._limit = lanes, node, found, doubt, limit
        self._intake = Intake("midspan-ros1-calls")
        self._prober = Prober(lanes, node, self._probed, self._handshake, "server")
        self._lock = threading.Lock()
        self._following = threading.Lock()  # what was known before must not be followed after what is known now
        self._links: frozenset[Link] = frozenset()
        self._callers: set[Caller] = set()
        self._check_due = 0.0
        self.servers = Servers(self._intake, node, origin, wake, limit)

    def stop(self) -> None:
        """Close everything."""
        with self._lock:
            callers, self._callers = list(self._callers), set()
        for caller in callers:
            caller.close()
        self.servers.close()
        self._intake.stop()

    # -- the graph -----------------------------------------------------------------------------------------------------

    def seen(self, look: Look | None) -> None:
        """One look at the master; on its thread."""
        own = self._node()
        links = frozenset(s for s in look.servers if s.node != own) if look is not None else frozenset()
        changed = links != self._links
        self._links = links
        if changed or self._prober.waiting:
            self._prober.follow(links)
        with self._lock:
            restless = any(caller.restless for caller in self._callers)
        if changed or restless:
            self._follow()
        self._check_rivals()

    def _check_rivals(self) -> None:
        """Look whether those still live who serve what we would serve too: nobody else might notice their death."""
        if time.monotonic() < self._check_due:
            return
        self._check_due = time.monotonic() + _CHECK_PERIOD
        known = self._prober.facts().keys()
        for link in self._rivals():
            if link in known:
                self._prober.check(link)

    def _rivals(self) -> list[Link]:
        ours = frozenset(self.servers.names())
        return sorted(link for link in self._links if link.topic in ours) if ours else []

    @property
    def links(self) -> frozenset[Link]:
        """The other nodes' servers at the last look."""
        return self._links

    def endpoints(self, look: Look) -> Iterator[Endpoint]:
        """The other nodes' servers."""
        own, facts = self._node(), self._prober.facts()
        midspans = {entry.get("node") for entry in look.presence.values()}
        for link in look.servers:
            if link.node != own:
                yield _endpoint(link, facts.get(link), midspan=link.node in midspans)

    def is_gone(self, link: Link) -> bool:
        """Whether a server is known to be dead though the master still names it."""
        return self._prober.is_gone(link)

    def warnings(self) -> Iterator[str]:
        """What a person should know."""
        for link, trouble in sorted(self._prober.troubles().items()):
            if not link.topic.endswith(_OF_EVERY_NODE):
                yield f"{link.topic}: its server {link.node} does not tell its type: {trouble}"
        for link in self._rivals():
            if not self.is_gone(link):
                yield f"{link.topic}: {link.node} serves it on ROS 1 itself, so the hub's is not offered there"

    def _handshake(self, caller: str, uri: str, service: str, seconds: float) -> tuple[DeadlineSocket, Header]:
        try:
            return connect_service(caller, uri, service, seconds, md5sum="*", probe="1")
        except ExhaustedError:
            raise
        except Ros1Error:
            self._doubt(service)
            raise

    def _probed(self, link: Link) -> None:
        self._follow(link.topic)
        self._found()

    def _doubted(self, link: Link, trouble: str) -> None:
        self._doubt(link.topic)
        self._prober.doubt(link, trouble)

    # -- our callers and servers ---------------------------------------------------------------------------------------

    def caller(self, name: str, side_type: SideType) -> _Open:
        """See `bridge.adapters.base.Edge.caller`."""
        caller = Caller(
            name, side_type,
            intake=self._intake, lanes=self._lanes, node=self._node, doubt=self._doubted, limit=self._limit,
        )  # fmt: skip
        with self._lock:
            self._callers.add(caller)
        self._follow(name)
        return _Open(self, caller)

    def closed(self, caller: Caller) -> None:
        """A caller was given back."""
        with self._lock:
            self._callers.discard(caller)

    def _follow(self, name: str = "") -> None:
        """Have callers follow what is known of the servers: all, or those of one service."""
        with self._lock:
            callers = [caller for caller in self._callers if name in ("", caller.name)]
        if not callers:
            return
        with self._following:
            servers = {link.topic: (link, facts) for link, facts in self._prober.facts(name).items() if facts.native}
            for caller in callers:
                link, facts = servers.get(caller.name, (None, None))
                fits = facts is not None and (caller.md5 == facts.md5 or caller.md5 in _ANY_MD5)
                caller.follow(link if fits else None)


class _Open:
    """An open caller, as the engine holds it."""

    def __init__(self, services: Services, caller: Caller) -> None:
        self._services, self._caller = services, caller

    def call(self, request: bytes, done: Done) -> Abandon:
        """See `bridge.adapters.base.EdgeCaller.call`."""
        return self._caller.call(request, done)

    def close(self) -> None:
        """See `bridge.adapters.base.EdgeCaller.close`."""
        self._services.closed(self._caller)
        self._caller.close()


def _endpoint(link: Link, facts: Facts | None, *, midspan: bool) -> Endpoint:
    if midspan or (facts is not None and not facts.native):
        made_by = MadeBy.MIDSPAN
    else:
        made_by = MadeBy.UNKNOWN if facts is None else MadeBy.NATIVE
    name = f"server {link.topic} {link.node} {link.uri}"
    type_, md5 = (facts.type, facts.md5) if facts is not None else ("", "")
    return Endpoint(name, Kind.SERVER, link.topic, type_, Qos(), made_by, link.node, md5)

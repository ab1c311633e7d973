"""The bridge's own ports on a YARP network: opened and closed as planned, and connected with whom they should be."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from bridge.adapters.base import MadeBy
from bridge.adapters.yarp.call_bottles import CallBottles
from bridge.adapters.yarp.contents import Contents
from bridge.adapters.yarp.crew import Crew
from bridge.adapters.yarp.graph import Graph
from bridge.adapters.yarp.inlet import Inlet
from bridge.adapters.yarp.names import DAEMON, OWNER, PortNames
from bridge.adapters.yarp.outlet import Outlet, TopicOutput
from bridge.adapters.yarp.plan import Link, PortPlan
from bridge.adapters.yarp.served import ServedPort
from bridge.adapters.yarp.shown import shown
from bridge.hub.call import Call
from bridge.messages.errors import MessageTypeError
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.errors import NamingError
from yarp_compat.ports.events import ConnectionEvent
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.contact import Contact

_log = logging.getLogger(__name__)

_THREADS = 8
_CONNECT_SECONDS = 2.0
_AGAIN = 2.0
"""Seconds after which a port that could not be opened is tried again."""

_LINK_AGAIN = 0.5
"""Seconds after which a connection that could not be made is."""

_STOP_SECONDS = 1.0
_LEAVE_SECONDS = 0.02
"""Seconds that each thread has to end, where it has nothing to do any more."""


class Served(Protocol):
    """A service of the hub that YARP programs may call."""

    @property
    def name(self) -> str:
        """The service's."""

    @property
    def bottles(self) -> CallBottles:
        """The converter."""

    @property
    def call(self) -> Call:
        """The service itself."""


@dataclass(eq=False)
class Own:
    """One port that is open."""

    plan: PortPlan
    core: PortCore
    inlet: Inlet | None
    output: TopicOutput | None
    links: Mapping[str, Link]
    served: ServedPort | None = None
    service: Served | None = None
    due: dict[str, float] = field(default_factory=dict)
    making: dict[str, Future[bool]] = field(default_factory=dict)


class OwnPorts:
    """Opens, connects and closes ports; one thread calls it, but for `inlets` and `peers`.

    Args:
        naming: the name server.
        owner: id of this worker.
        daemon: the daemon's name.
        contents: the converters.
        graph: the network.
        refused: told of messages that are none.
        changed: called when a connection came or went.
        limit: bytes of the largest message.
        ip: address to listen on, None for the usual one.
        awake: tells whether another worker of Midspan's is there and not standing still.
        names: the scheme.
    """

    def __init__(
        self,
        naming: NameClient,
        owner: str,
        daemon: str,
        contents: Contents,
        graph: Graph,
        refused: Callable[[str, str, str], None],
        changed: Callable[[], None],
        limit: int,
        ip: str | None,
        awake: Callable[[str], bool],
        names: PortNames,
    ) -> None:
        self._awake, self._names = awake, names
        self._naming, self._owner, self._daemon = naming, owner, daemon
        self._contents, self._graph = contents, graph
        self._refused, self._changed = refused, changed
        self._limit, self._ip = limit, ip
        self._own: dict[str, Own] = {}
        self._services: Mapping[str, Served] = {}
        self._taken: frozenset[str] = frozenset()
        self._stopped = False
        self._trouble: dict[str, tuple[float, str]] = {}
        self._links, self._ends = Crew(_THREADS, "midspan-yarp-links"), Crew(_THREADS, "midspan-yarp-ends")

    # -- what there is -------------------------------------------------------------------------------------------------

    def inlets(self) -> list[Inlet]:
        """The input ports."""
        return [own.inlet for own in list(self._own.values()) if own.inlet is not None]

    def inputs(self) -> list[tuple[PortPlan, list[str]]]:
        """The topics' own input ports, each with the ports that are connected to it."""
        return [
            (own.plan, sorted({route.source for route in own.core.inputs()} | own.inlet.waiting()))
            for own in list(self._own.values())
            if own.inlet is not None and own.plan.own
        ]

    def peers(self) -> set[str]:
        """All ports that bring messages, or brought one that is held."""
        found = set[str]()
        for own in list(self._own.values()):
            if own.inlet is not None:
                found |= own.inlet.waiting()
                found.update(route.source for route in own.core.inputs())
        return found

    def is_ours(self, name: str) -> bool:
        """Whether this worker opened a port."""
        return name in self._taken

    def warnings(self) -> list[str]:
        """What cannot be opened or connected."""
        return sorted(text for _, text in list(self._trouble.values()))

    def shown(self) -> list[dict[str, Any]]:
        """All ports, for people."""
        owns = sorted(self._own.values(), key=lambda own: own.core.name)
        return [shown(own.plan, own.core, self._contents.generations) for own in owns]

    def look_for_callers(self) -> None:
        """Abandon the calls whose callers have gone."""
        for own in self._own.values():
            if own.served is not None:
                own.served.look()

    # -- what there should be ------------------------------------------------------------------------------------------

    def follow(
        self, plan: Mapping[str, PortPlan], outputs: Mapping[str, TopicOutput], services: Mapping[str, Served]
    ) -> None:
        """Make the ports those of the plan."""
        self._services = services
        owned = self._own
        gone = [name for name, own in owned.items() if plan.get(name) != own.plan or self._stale(own, outputs)]
        self._close([owned.pop(name) for name in gone])
        now = time.monotonic()
        for key in list(self._trouble):  # in place: the threads that connect write to it, too
            if key.partition(" ")[0] not in plan:
                self._trouble.pop(key, None)
        for name, port in plan.items():
            own = self._own.get(name)
            if own is not None:
                own.links = port.links
            elif now >= self._trouble.get(name, (0.0, ""))[0]:
                self._open(port, outputs.get(port.topic))

    def _stale(self, own: Own, outputs: Mapping[str, TopicOutput]) -> bool:
        if own.service is not None:
            return self._services.get(own.plan.topic) is not own.service
        return own.output is not None and outputs.get(own.plan.topic) is not own.output

    def _open(self, port: PortPlan, output: TopicOutput | None) -> None:
        if self._stopped or (port.writes and output is None):
            return
        try:
            own = self._made(port, self._free_name(port.name), output)
            self._own[port.name] = own
            self._taken |= {own.core.name}
            if output is not None and port.writes:  # before it opens: who connects at once gets what is kept
                output.add(Outlet(own.core, port.content))
            own.core.open()
            if self._stopped:  # meanwhile, and `stop` found it closed
                self._close([own])
                return
            # Before anybody can be asked to connect: what is not marked may be taken for a YARP program's.
            self._naming.set_property(own.core.name, OWNER, self._owner)
        except (OSError, MessageTypeError) as err:
            self._trouble[port.name] = time.monotonic() + _AGAIN, f"{port.name}: {err}"
            failed = self._own.pop(port.name, None)
            if failed is not None:
                self._close([failed])
            return
        self._trouble.pop(port.name, None)

    def _free_name(self, name: str) -> str:
        """The name that a port gets: what a dead or stopped worker of ours has is taken over, nobody else's is."""
        for wanted in (name, self._names.spare(name)):
            known = self._naming.query(wanted)
            if known is None or not connections.responds(known, timeout=_CONNECT_SECONDS):
                return wanted
            owner = [str(value) for value in self._naming.get_property(wanted, OWNER)]
            if owner and (owner == [self._owner] or not self._awake(owner[0])):
                return wanted
        msg = "another program has a port of this name; choose other names with yarp.output and yarp.input"
        raise NamingError(msg)

    def _made(self, port: PortPlan, name: str, output: TopicOutput | None) -> Own:
        if port.rpc:
            service = self._services[port.topic]
            served = ServedPort(service.name, service.bottles, service.call, self.made_by, self._refused)
            return Own(port, self._core(port, name, served), None, None, port.links, served, service)
        side, profile = port.type, port.content.profile
        if port.writes:
            self._contents.codec(port.content, side, port.type_hash, profile)  # tells at once what cannot be said
            core = self._core(port, name, None)
            return Own(port, core, None, output, port.links)
        codec = self._contents.codec(port.content, side, port.type_hash, profile)
        only = None if port.own else self._linked(port.name)
        inlet = Inlet(name, port.topic, side, codec, only, port.source, self.made_by, self._refused)
        return Own(port, self._core(port, name, inlet), inlet, None, port.links)

    def _linked(self, name: str) -> Callable[[str], bool]:
        def is_linked(peer: str) -> bool:
            own = self._own.get(name)
            return own is not None and peer in own.links

        return is_linked

    def made_by(self, name: str) -> MadeBy:
        """Who made a port."""
        return MadeBy.MIDSPAN if self.is_ours(name) else self._graph.made_by(name)

    def _core(self, port: PortPlan, name: str, hearer: Inlet | ServedPort | None) -> PortCore:
        core = PortCore(
            name,
            on_message=hearer.on_message if hearer is not None else None,
            rpc=port.rpc,
            naming=self._naming,
            type_name="",
            limit=self._limit,
            host=self._ip,
            profile=port.content.profile,
            is_input=not port.writes,
            is_output=port.writes,
        )
        core.on_event = lambda event: self._on_event(port.name, core, event)
        return core

    def _on_event(self, name: str, core: PortCore, event: ConnectionEvent) -> None:
        own = self._own.get(name)
        if own is not None and event.up and not event.incoming:
            target = event.route.target
            link = own.links.get(target)
            if link is not None and link.profile is not None:
                for output in core.connections.outputs:
                    if output.route.target == target:
                        output.profile = link.profile
            if own.output is not None:
                own.output.welcome(core, target)
        elif own is not None and event.up:
            link = own.links.get(event.route.source)
            if link is not None and link.profile is not None:
                for one in core.connections.inputs:
                    if one.route.source == event.route.source:
                        one.profile = link.profile
        elif not event.up:
            self._graph.forget(event.route.source if event.incoming else event.route.target)
        self._changed()

    def leave_taken(self, contacts: Mapping[str, Contact]) -> None:
        """Close the ports whose names others have by now: of two that opened one at once, the first is forgotten."""
        owned = self._own
        taken = [
            key
            for key, own in owned.items()
            if (found := contacts.get(own.core.name)) is not None
            and (found.host, found.port) != (own.core.contact.host, own.core.contact.port)
        ]
        self._close([owned.pop(key) for key in taken])

    def mark_again(self, contacts: Mapping[str, Contact], *, returned: bool) -> None:
        """Register and mark the ports that a name server forgot; mark all where it has just returned."""
        for own in self._own.values():
            forgotten = own.core.name not in contacts
            if forgotten:
                self._naming.restore(own.core.name)
            if forgotten or returned:
                self._naming.set_property(own.core.name, OWNER, self._owner)

    def bury(self, contacts: Mapping[str, Contact], names: PortNames) -> None:
        """Remove what a dead predecessor of this worker left at the name server."""
        for name, contact in contacts.items():
            if not names.may_be(name):
                continue
            owner = [str(value) for value in self._naming.get_property(name, OWNER)]
            # One without an owner may have been killed before it was marked; a number may have gone to another program.
            if owner == [self._owner] or (not owner and not connections.responds(contact, timeout=_CONNECT_SECONDS)):
                self._naming.unregister(name)

    # -- connections ---------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Make the connections that are missing; those that take long are made meanwhile."""
        now = time.monotonic()
        for name, own in self._own.items():
            if not own.links:
                continue
            linked = (
                {r.target for r in own.core.outputs()} if own.plan.writes else {r.source for r in own.core.inputs()}
            )
            for peer, link in own.links.items():
                key = f"{name} {peer}"
                if peer in linked:
                    self._trouble.pop(key, None)
                elif peer not in self._graph.contacts:
                    self._trouble[key] = 0.0, f"{peer} is not there; it is connected to {name} when it comes"
                elif peer not in own.making and now >= own.due.get(peer, 0.0):
                    own.due[peer] = now + _LINK_AGAIN
                    own.making[peer] = self._links.submit(partial(self._link, own, peer, link))
            for peer in [peer for peer, future in own.making.items() if future.done()]:
                del own.making[peer]

    def _link(self, own: Own, peer: str, link: Link) -> bool:
        key, problem = f"{own.core.name} {peer}", ""
        try:
            if self._naming.get_property(peer, OWNER):
                problem = f"{peer} is a port of Midspan's; what it carries is not taken up again"
            elif self._naming.is_taken(own.core.name):  # while we stood still: its connection would end by ours
                problem = f"{own.core.name} is the name of another program's port by now"
            elif own.plan.writes:
                done, told = own.core.add_output(f"{link.carrier}:/{peer}" if link.carrier else peer)
                problem = "" if done else f"{own.core.name}: {told}"
            else:
                connections.connect(self._naming, peer, own.core.name, link.carrier, timeout=_CONNECT_SECONDS)
            if not problem and "@" in peer:
                self._naming.set_property(peer, DAEMON, self._daemon)
        except OSError as err:
            problem = str(err)
            self._graph.died(peer)
        if problem:
            self._trouble[key] = 0.0, problem
        else:
            self._trouble.pop(key, None)
        self._changed()
        return not problem

    # -- the end -------------------------------------------------------------------------------------------------------

    def _close(self, owns: list[Own]) -> None:
        """Close ports, all at once; what takes too long goes on without us."""
        self._taken -= {own.core.name for own in owns}
        for own in owns:
            if own.output is not None:
                own.output.drop(own.core)
            if own.inlet is not None:
                own.inlet.hear(None)
            if own.served is not None:
                own.served.close()
        ends = [self._ends.submit(partial(self._end, own.core)) for own in owns]
        deadline = time.monotonic() + _STOP_SECONDS
        for own, end in zip(owns, ends, strict=True):
            try:
                end.result(max(0.0, deadline - time.monotonic()))
            except CancelledError:  # we stop: nobody else does it any more
                self._end(own.core)
            except TimeoutError:
                _log.warning("closing ports takes long; they are left to themselves")
                return
            except Exception:
                _log.exception("closing a port failed")

    def _end(self, core: PortCore) -> None:
        """Close a port; a name that another one took, perhaps while we stood still, stays its own."""
        with contextlib.suppress(NamingError):
            if self._naming.is_taken(core.name):
                self._naming.leave(core.name)
        core.close()

    def stop(self) -> None:
        """Close everything, and open nothing any more."""
        self._stopped = True
        owned, self._own = self._own, {}  # another thread may go through it
        self._close(list(owned.values()))
        for crew in (self._links, self._ends):
            crew.close(_LEAVE_SECONDS)

"""The bridge's ports on a YARP network: opened, connected and closed according to the plan."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from bridge.adapters.yarp.graph import YarpContext
from bridge.adapters.yarp.network import DAEMON, OWNER
from bridge.adapters.yarp.plan import PlannedLink, PortPlan, status_of
from bridge.adapters.yarp.services import OfferedService, ServedPort
from bridge.adapters.yarp.topics import InputPort, OutputPort, TopicOutput
from bridge.concurrency import WorkerPool
from bridge.messages.errors import MessageTypeError
from bridge.reconnecting_clients import ReconnectingClients
from bridge.routing.edge import MadeBy
from yarp_compat.naming import connections
from yarp_compat.naming.server import refused
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.ports.naming import NamingError, NoNameServerError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.contact import PortContact

_log = logging.getLogger(__name__)

_THREADS = 8
_CONNECT_SECONDS = 2.0
_RETRY = 2.0
"""Seconds before the next attempt to open a port."""

_LINK_RETRY = 0.5
"""Seconds before the next attempt to connect a port."""

_REFUSED_SECONDS = 5.0
"""Seconds of refused connections after which a port without a mark counts as dead."""

_STOP_SECONDS = 1.0
_LEAVE_SECONDS = 0.02
"""Seconds for each idle thread to exit."""


@dataclass(eq=False)
class OwnPort:
    """An open port."""

    plan: PortPlan
    core: PortCore
    links: Mapping[str, PlannedLink]
    input_port: InputPort | None = None
    output: TopicOutput | None = None
    served: ServedPort | None = None
    service: OfferedService | None = None
    due: dict[str, float] = field(default_factory=dict)
    pending: dict[str, Future[bool]] = field(default_factory=dict)


class OwnPorts:
    """The open ports. The methods that open, connect or close ports are called on one thread, the others on any.

    Args:
        awake: returns whether another Midspan worker is present and not stalled.
        clients: the list of reconnecting clients of the RPC ports.

    Attributes:
        own: the open ports, by name.
        trouble: the time of the next attempt and the error, by a port's name or by the names of a connection's ends.
    """

    def __init__(self, context: YarpContext, awake: Callable[[str], bool], clients: ReconnectingClients) -> None:
        self._context, self._awake, self._clients = context, awake, clients
        self._naming, self._owner, self._graph = context.naming, context.owner, context.graph
        self._update: Future[bool] | None = None
        self.own: dict[str, OwnPort] = {}
        self._services: Mapping[str, OfferedService] = {}
        self._own_names: frozenset[str] = frozenset()
        self._unmarked: dict[PortContact, float] = {}
        self._stopped = False
        self.trouble: dict[str, tuple[float, str]] = {}
        self._links, self._ends = WorkerPool(_THREADS, "midspan-yarp-links"), WorkerPool(_THREADS, "midspan-yarp-ends")

    # -- state ---------------------------------------------------------------------------------------------------------

    def input_ports(self) -> list[InputPort]:
        """Return the input ports."""
        return [port.input_port for port in list(self.own.values()) if port.input_port is not None]

    def inputs(self) -> list[tuple[PortPlan, list[str]]]:
        """Return the topics' main input ports, each with the ports that write to it."""
        return [
            (port.plan, sorted({route.source for route in port.core.inputs()} | port.input_port.waiting()))
            for port in list(self.own.values())
            if port.input_port is not None and port.plan.own
        ]

    def peers(self) -> set[str]:
        """Return all ports that write to Midspan's ports, and all ports whose message is held."""
        peers = set[str]()
        for port in list(self.own.values()):
            if port.input_port is not None:
                peers |= port.input_port.waiting()
                peers.update(route.source for route in port.core.inputs())
        return peers

    def is_ours(self, name: str) -> bool:
        """Return whether this worker opened the port."""
        return name in self._own_names

    def warnings(self) -> list[str]:
        """Return the errors of ports that cannot be opened or connected."""
        return sorted(text for _, text in list(self.trouble.values()))

    def status(self) -> list[dict[str, Any]]:
        """Return all ports' entries for the status document."""
        ports = sorted(self.own.values(), key=lambda port: port.core.name)
        return [status_of(port.plan, port.core) for port in ports]

    def abandon_calls(self) -> None:
        """Abandon the calls of clients that have left."""
        for port in self.own.values():
            if port.served is not None:
                port.served.abandon_calls()

    # -- opening -------------------------------------------------------------------------------------------------------

    def apply(
        self, plan: Mapping[str, PortPlan], outputs: Mapping[str, TopicOutput], services: Mapping[str, OfferedService]
    ) -> None:
        """Open and close ports according to the plan."""
        self._services = services
        owned = self.own
        stale = [name for name, port in owned.items() if plan.get(name) != port.plan or self._stale(port, outputs)]
        self._close([owned.pop(name) for name in stale])
        now = time.monotonic()
        for key in list(self.trouble):  # in place, because connecting threads write to it, too
            if key.partition(" ")[0] not in plan:
                self.trouble.pop(key, None)
        for name, planned in plan.items():
            port = self.own.get(name)
            if port is not None:
                self._disconnect_joined(port, planned.links)
                port.links = planned.links
            elif now >= self.trouble.get(name, (0.0, ""))[0]:
                self._open(planned, outputs.get(planned.topic))

    def _disconnect_joined(self, port: OwnPort, links: Mapping[str, PlannedLink]) -> None:
        """Close the connections with ports that have been joined to ROS 1."""
        for peer in (port.links.keys() - links.keys()) & self._graph.ros1:
            end = port.core.remove_output if port.plan.writes else port.core.remove_input
            end(peer)

    def _stale(self, port: OwnPort, outputs: Mapping[str, TopicOutput]) -> bool:
        if port.service is not None:
            return self._services.get(port.plan.topic) is not port.service
        return port.output is not None and outputs.get(port.plan.topic) is not port.output

    def _open(self, port: PortPlan, output: TopicOutput | None) -> None:
        if self._stopped or (port.writes and output is None):
            return
        try:
            opened = self._create(port, self._free_name(port.name), output)
            self.own[port.name] = opened
            self._own_names |= {opened.core.name}
            if output is not None and port.writes:  # before opening, so that every new reader gets the cached messages
                output.add(OutputPort(opened.core, port.content))
            opened.core.open()
            if self._stopped:  # `stop` was called before this port was open, and therefore did not close it
                self._close([opened])
                return
            # Mark the port before it has any connection, because an unmarked port looks like a YARP program's.
            self._naming.set_property(opened.core.name, OWNER, self._owner)
            if port.rpc:
                self._clients.watch(opened.core)
        except (OSError, MessageTypeError) as err:
            self.trouble[port.name] = time.monotonic() + _RETRY, f"{port.name}: {err}"
            failed = self.own.pop(port.name, None)
            if failed is not None:
                self._close([failed])
            return
        self.trouble.pop(port.name, None)

    def _free_name(self, name: str) -> str:
        """Return the name for a port; only names of dead or stalled Midspan workers and dead ports are taken over.

        A port that does not answer may be alive: its network may be slow, or this process may have been suspended.
        """
        for wanted in (name, self._context.names.alternative(name)):
            known = self._naming.query(wanted)
            if known is None or refused([known], _CONNECT_SECONDS):
                return wanted
            owner = [str(value) for value in self._naming.get_property(wanted, OWNER)]
            if owner and (owner == [self._owner] or not self._awake(owner[0])):
                return wanted
        raise NamingError("another program has a port of this name; choose other names with yarp.output and yarp.input")

    def _create(self, port: PortPlan, name: str, output: TopicOutput | None) -> OwnPort:
        if port.rpc:
            service = self._services[port.topic]
            served = ServedPort(service.name, service.bottles, service.call, self.made_by, self._context.refused)
            return OwnPort(port, self._core(port, name, served), port.links, served=served, service=service)
        # raises if the type cannot be converted
        codec = self._context.contents.codec(port.content, port.type, port.type_hash, port.content.profile)
        if port.writes:
            return OwnPort(port, self._core(port, name, None), port.links, output=output)
        only, refused = None if port.own else self._linked(port.name), self._context.refused
        input_port = InputPort(name, port.topic, port.type, codec, only, port.source, self.made_by, refused)
        return OwnPort(port, self._core(port, name, input_port), port.links, input_port)

    def _linked(self, name: str) -> Callable[[str], bool]:
        def is_linked(peer: str) -> bool:
            port = self.own.get(name)
            return port is not None and peer in port.links

        return is_linked

    def made_by(self, name: str) -> MadeBy:
        """Return who created a port."""
        return MadeBy.MIDSPAN if self.is_ours(name) else self._graph.made_by(name)

    def _core(self, port: PortPlan, name: str, receiver: InputPort | ServedPort | None) -> PortCore:
        core = PortCore(
            name,
            on_message=receiver.on_message if receiver is not None else None,
            rpc=port.rpc,
            naming=self._naming,
            type_name="",
            limit=self._context.limit,
            host=self._context.ip,
            profile=port.content.profile,
            is_input=not port.writes,
            is_output=port.writes,
        )
        core.on_event = lambda event: self._on_event(port.name, core, event)
        return core

    def _on_event(self, name: str, core: PortCore, event: ConnectionEvent) -> None:
        port, peer = self.own.get(name), event.route.source if event.incoming else event.route.target
        if not event.up:
            self._graph.discard(peer)
        elif port is not None:
            link = port.links.get(peer)
            if link is not None and link.profile is not None:
                for connection in core.connections.inputs if event.incoming else core.connections.outputs:
                    if peer == (connection.route.source if event.incoming else connection.route.target):
                        connection.profile = link.profile
            if port.output is not None and not event.incoming:
                port.output.send_latched(core, peer)
        self._context.changed()

    def close_replaced(self, contacts: Mapping[str, PortContact]) -> None:
        """Close ports whose names other programs have registered since: the port that was registered last stays."""
        owned = self.own
        replaced = [
            key
            for key, port in owned.items()
            if (contact := contacts.get(port.core.name)) is not None
            and (contact.host, contact.port) != (port.core.contact.host, port.core.contact.port)
        ]
        self._close([owned.pop(key) for key in replaced])

    def restore_marks(self, contacts: Mapping[str, PortContact], *, returned: bool) -> None:
        """Restore and mark the ports that the name server has lost; if it has just returned, mark all ports."""
        for port in self.own.values():
            lost = port.core.name not in contacts
            if lost:
                self._naming.restore(port.core.name)
            if lost or returned:
                self._naming.set_property(port.core.name, OWNER, self._owner)

    def unregister_dead(self, contacts: Mapping[str, PortContact]) -> None:
        """Unregister the ports of a dead predecessor of this worker; `unregister_unmarked` follows."""
        for name, contact in contacts.items():
            if not self._context.names.matches(name):
                continue
            owner = [str(value) for value in self._naming.get_property(name, OWNER)]
            if owner == [self._owner]:
                self._naming.unregister(name)
            elif not owner:
                self._unmarked[contact] = time.monotonic()  # again at each attempt to join, which is no probe

    def unregister_unmarked(self, contacts: Mapping[str, PortContact]) -> None:
        """Unregister the unmarked ports that have refused connections at each update for a few seconds.

        A worker may have been killed before it marked them. Another program may now use the port number, and a new port
        refuses connections until it listens.
        """
        now = time.monotonic()
        dead = refused([c for c in self._unmarked if contacts.get(c.name) == c], _CONNECT_SECONDS)
        self._unmarked = {contact: since for contact, since in self._unmarked.items() if contact.name in dead}
        for contact in [contact for contact, since in self._unmarked.items() if now - since > _REFUSED_SECONDS]:
            if not self._naming.get_property(contact.name, OWNER):
                self._naming.unregister(contact.name)
            del self._unmarked[contact]

    # -- connections ---------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Make missing connections, in the background."""
        now = time.monotonic()
        if (self._update is None or self._update.done()) and any(port.served for port in self.own.values()):
            self._update = self._links.submit(self._clients.update)
        for name, port in self.own.items():
            if not port.links:
                continue
            linked = (
                {r.target for r in port.core.outputs()} if port.plan.writes else {r.source for r in port.core.inputs()}
            )
            for peer, link in port.links.items():
                key = f"{name} {peer}"
                if peer in linked:
                    self.trouble.pop(key, None)
                elif peer not in self._graph.contacts:
                    self.trouble[key] = 0.0, f"waiting for {peer}, to connect it to {name}"
                elif peer not in port.pending and now >= port.due.get(peer, 0.0):
                    port.due[peer] = now + _LINK_RETRY
                    port.pending[peer] = self._links.submit(partial(self._link, port, peer, link))
            for peer in [peer for peer, future in port.pending.items() if future.done()]:
                del port.pending[peer]

    def _link(self, port: OwnPort, peer: str, link: PlannedLink) -> bool:
        key, problem = f"{port.core.name} {peer}", ""
        try:
            if self._naming.get_property(peer, OWNER):
                problem = f"{peer} is a port of Midspan; its messages are not bridged again"
            elif self._naming.is_taken(port.core.name):  # connecting would close that program's connection
                problem = f"another program has the name {port.core.name}"
            elif port.plan.writes:
                done, reason = port.core.add_output(f"{link.carrier}:/{peer}" if link.carrier else peer)
                problem = "" if done else f"{port.core.name}: {reason}"
            else:
                connections.connect(self._naming, peer, port.core.name, link.carrier, timeout=_CONNECT_SECONDS)
            if not problem and "@" in peer:
                self._naming.set_property(peer, DAEMON, self._context.daemon)
        except NoNameServerError as err:  # the peer may be reachable
            problem = str(err)
        except OSError as err:
            problem = str(err)
            self._graph.mark_unreachable(peer)
        if problem:
            self.trouble[key] = 0.0, problem
        else:
            self.trouble.pop(key, None)
        self._context.changed()
        return not problem

    # -- closing -------------------------------------------------------------------------------------------------------

    def _close(self, ports: list[OwnPort]) -> None:
        """Close ports in parallel; after `_STOP_SECONDS` the rest is closed in the background."""
        self._own_names -= {port.core.name for port in ports}
        for port in ports:
            if port.output is not None:
                port.output.drop(port.core)
            if port.input_port is not None:
                port.input_port.deliver_to(None)
            if port.served is not None:
                self._clients.unwatch(port.core)
                port.served.close()
        ends = [self._ends.submit(partial(self._end, port.core)) for port in ports]
        deadline = time.monotonic() + _STOP_SECONDS
        for port, end in zip(ports, ends, strict=True):
            try:
                end.result(max(0.0, deadline - time.monotonic()))
            except CancelledError:  # the adapter is stopping, and the pool no longer runs its jobs
                self._end(port.core)
            except TimeoutError:
                _log.warning("some ports are still closing; this continues in the background")
                return
            except Exception:
                _log.exception("cannot close a port")

    def _end(self, core: PortCore) -> None:
        """Close a port; a name that another program has taken, perhaps during a stall, stays registered."""
        with contextlib.suppress(NamingError):
            if self._naming.is_taken(core.name):
                self._naming.leave(core.name)
        core.close()

    def stop(self) -> None:
        """Close all ports permanently."""
        self._stopped = True
        owned, self.own = self.own, {}  # another thread may be iterating over the old mapping
        self._close(list(owned.values()))
        for pool in (self._links, self._ends):
            pool.close(_LEAVE_SECONDS)

"""Services on the YARP side: RPC ports for the hub's services, and clients of the RPC ports that rules name."""

from __future__ import annotations

import itertools
import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from bridge.adapters.yarp.contents import CallBottles
from bridge.adapters.yarp.graph import YarpContext
from bridge.adapters.yarp.network import OWNER
from bridge.adapters.yarp.plan import PortPlan
from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done, nothing
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.transcode.conversion import ServiceConversion, SideType
from bridge.routing.edge import MadeBy
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import Unregistered
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.errors import WireError

_log = logging.getLogger(__name__)

Refused = Callable[[str, str, str], None]


class ServedPort:
    """The server of one service on an RPC port. A call blocks only its own connection.

    Args:
        made_by: returns who created a port.
        refused: called for each refused request: service, reason, explanation.
    """

    def __init__(
        self, service: str, bottles: CallBottles, call: Call, made_by: Callable[[str], MadeBy], refused: Refused
    ) -> None:
        self.service = service
        self._bottles, self._call, self._made_by, self._refused = bottles, call, made_by, refused
        self._lock = threading.Lock()
        self._waiting: dict[PortMessage, Abandon] = {}
        self._closed = False

    def on_message(self, message: PortMessage) -> None:
        """Handle a request, on its connection's thread."""
        peer = message.peer
        if self._made_by(peer.route.source) is MadeBy.MIDSPAN:
            self._reply(message, CallError("Midspan does not serve its own calls"))
            return
        try:
            request, peer.profile = self._bottles.request_to_hub(message.payload, peer.profile)
        except ConversionError as err:
            self._refused(self.service, "bad", f"from {peer.route.source}: {err}")
            self._reply(message, CallError(str(err)))
            return
        message.later()
        with self._lock:
            closed = self._closed
            if not closed:
                self._waiting[message] = nothing
        if closed:
            self._reply(message, CallError(f"{self.service} is no longer served"))
            return
        abandon = self._call(request, partial(self._answer, message))
        with self._lock:
            if waits := message in self._waiting:
                self._waiting[message] = abandon
        if not waits:  # meanwhile the client left, or the service closed
            abandon()

    def abandon_calls(self) -> None:
        """Abandon the calls of clients that have left."""
        with self._lock:
            waiting = list(self._waiting)
        for message in waiting:
            peer = message.peer
            if isinstance(peer, Input) and peer.is_gone:
                abandon = self._remove(message)
                message.give_up()
                if abandon is not None:
                    abandon()

    def close(self) -> None:
        """End all pending calls with an error."""
        with self._lock:
            self._closed = True
            waiting, self._waiting = self._waiting, {}
        for message, abandon in waiting.items():
            abandon()
            self._reply(message, CallError(f"{self.service} is no longer served"))

    def _answer(self, message: PortMessage, result: bytes | CallError) -> None:
        if self._remove(message) is not None:
            self._reply(message, result)

    def _remove(self, message: PortMessage) -> Abandon | None:
        with self._lock:
            return self._waiting.pop(message, None)

    def _reply(self, message: PortMessage, result: bytes | CallError) -> None:
        profile = message.peer.profile
        try:
            reply = self._bottles.reply_to_yarp(result, profile)
        except ConversionError as err:
            _log.warning("%s: cannot convert the reply for YARP: %s", self.service, err)
            reply = self._bottles.reply_to_yarp(CallError(str(err)), profile)
        message.reply(reply)


# -- clients of RPC ports, with one connection for each call -----------------------------------------------------------

MAX_CALLS = 64
"""Maximum number of concurrent calls to one port."""

_NUMBERS = itertools.count(1)
_IDLE = 4
"""Maximum number of idle connections to a port, which the next calls reuse."""


class PortCaller:
    """A client of one RPC port (`bridge.routing.edge.EdgeCaller`); ``carrier`` is "" for the default."""

    def __init__(self, naming: NameClient, port: str, carrier: str, bottles: CallBottles, limit: int) -> None:
        self._naming, self._names, self._port = naming, Unregistered(naming), port
        self._target = f"{carrier}:/{port}" if carrier else port
        self._bottles, self._limit = bottles, limit
        self._lock = threading.Lock()
        self._idle: deque[PortCore] = deque()
        self._calls: set[_PortCall] = set()
        self._closed = False

    def call(self, request: bytes, done: Done) -> Abandon:
        """Start a call on its own thread; ``done`` gets the reply or an error."""
        with self._lock:
            trouble = ""
            if self._closed:
                trouble = f"{self._port} is no longer called"
            elif len(self._calls) >= MAX_CALLS:
                trouble = f"{self._port} is busy with {MAX_CALLS} calls"
            else:
                call = _PortCall(self, request, done)
                self._calls.add(call)
                core = self._idle.popleft() if self._idle else None
        if trouble:
            done(CallError(trouble))
            return nothing
        calling = threading.Thread(target=call.run, args=(core,), name=f"midspan-yarp-call {self._port}", daemon=True)
        try:
            calling.start()
        except RuntimeError as err:  # the system is out of threads
            call.end(CallError(f"{self._port} cannot be called: {err}"))
            self.finish(call, core)
            return nothing
        return call.abandon

    def close(self) -> None:
        """End all pending calls with an error."""
        with self._lock:
            self._closed = True
            calls, idle = list(self._calls), list(self._idle)
            self._idle.clear()
        for call in calls:
            call.end(CallError(f"{self._port} is no longer called"))
        for core in idle:
            core.close()

    def connection(self) -> PortCore:
        """Return a new port that is connected to the server; raises `OSError`."""
        if self._naming.get_property(self._port, OWNER):
            raise ConnectionRefusedError(f"{self._port} is a port of Midspan; its service is not bridged again")
        name = f"/midspan/call{next(_NUMBERS)}/{os.getpid()}"
        core = PortCore(name, naming=self._names, rpc=True, is_input=False, limit=self._limit)
        core.open()
        done, problem = core.add_output(self._target)
        if not done:
            core.close()
            raise ConnectionRefusedError(problem)
        return core

    def ask(self, core: PortCore, request: bytes) -> bytes:
        """Send a request and return the reply, both as CDR.

        Raises:
            OSError: the connection is lost.
            WireError: the reply is not a Bottle.
            ConversionError: the reply does not match the service's type.
            CallError: the reply reports a failure.
        """
        profile = core.answers_in
        reply = core.request(self._bottles.request_to_yarp(request, profile))
        return self._bottles.reply_to_hub(reply, profile)

    def finish(self, call: _PortCall, core: PortCore | None) -> None:
        """Remove a finished call; the next call may reuse its connection."""
        with self._lock:
            self._calls.discard(call)
            keep = core is not None and not self._closed and len(self._idle) < _IDLE
            if keep and core is not None:
                self._idle.append(core)
        if core is not None and not keep:
            core.close()


class _PortCall:
    """One call, on its own thread."""

    def __init__(self, caller: PortCaller, request: bytes, done: Done) -> None:
        self._caller, self._request = caller, request
        self._lock = threading.Lock()
        self._done: Done | None = done
        self._core: PortCore | None = None

    def run(self, core: PortCore | None) -> None:
        """Make the call on an idle connection or, if that is closed, on a new one, and pass on the reply."""
        result: bytes | CallError
        fresh: PortCore | None = None
        try:
            for output in core.connections.outputs if core is not None else ():
                output.check()  # the server may have left since the last periodic check
            if core is not None and not core.connections.outputs:
                core.close()
                core = None
            fresh = core or self._caller.connection()
            with self._lock:
                self._core = fresh if self._done is not None else None
            if self._core is None:
                self._caller.finish(self, fresh)
                return
            result = self._caller.ask(fresh, self._request)
        except CallError as err:
            result = err
        except ConversionError as err:
            result = CallError(f"malformed reply: {err}")
        except (OSError, RuntimeError, WireError) as err:  # RuntimeError: the system is out of threads
            what = "cannot be reached" if fresh is None else "disappeared before it replied"
            result = CallError(f"the port {what}: {err}")
            if fresh is not None:
                fresh.close()
                fresh = None
        with self._lock:
            self._core = None
        self.end(result)
        self._caller.finish(self, fresh)

    def abandon(self) -> None:
        with self._lock:
            self._done = None
            core, self._core = self._core, None
        if core is not None:
            core.close()

    def end(self, result: bytes | CallError) -> None:
        with self._lock:
            done, self._done = self._done, None
            core = self._core if isinstance(result, CallError) else None
        if core is not None:
            core.close()
        if done is not None:
            done(result)


# -- all services -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class OfferedService:
    """A service of the hub that YARP programs can call."""

    name: str
    side_type: SideType
    bottles: CallBottles
    call: Call
    drop: Callable[[OfferedService], None]

    def close(self) -> None:
        """Stop serving; pending calls end with an error. Safe to call twice."""
        self.drop(self)


class YarpServices:
    """The services that are served and called. All methods are thread-safe."""

    def __init__(self, context: YarpContext) -> None:
        self._context, self._contents, self._registry = context, context.contents, context.registry
        self._lock = threading.Lock()
        self._served: dict[str, OfferedService] = {}

    def called_ports(self) -> list[tuple[str, str, str]]:
        """Return port, service and type of each RPC port that a rule names."""
        return [(rule.port, rule.service, rule.type) for rule in self._contents.port_rules if rule.port and rule.type]

    def served(self) -> dict[str, OfferedService]:
        """Return the services that YARP programs can call, by name."""
        with self._lock:
            return dict(self._served)

    def plan(self, served: Mapping[str, OfferedService]) -> dict[str, PortPlan]:
        """Return the RPC ports for the services."""
        plan: dict[str, PortPlan] = {}
        for service in served.values():
            port = self._context.names.rpc(service.name)
            request, reply = self._contents.of_service(service.name)
            plan[port] = PortPlan(port, False, service.name, service.side_type.name, "", request, reply=reply)
        return plan

    def conversion(self, type_name: str, type_hash: str = "") -> ServiceConversion:
        """Return a conversion that only checks requests and replies; the ports convert them, each to its content."""
        known = self._registry.service_ros2(type_name, type_hash)
        request, response = self._registry.hub_service_check(type_name, type_hash)
        return ServiceConversion(known, known, request, None, response, None)

    def caller(self, name: str, side_type: SideType) -> PortCaller:
        """Return a client of the port that a rule names; raises `MessageTypeError` without such a rule."""
        rule = self._contents.served_by(name)
        if rule is None or rule.port is None:
            raise MessageTypeError(f"no rule of yarp.services names a port for {name}")
        bottles = self._contents.bottles(name, side_type.name, side_type.type_id)
        return PortCaller(self._context.naming, rule.port, rule.carrier or "", bottles, self._context.limit)

    def serve(self, name: str, side_type: SideType, call: Call) -> OfferedService:
        """Serve a service; raises `MessageTypeError` if its type cannot be sent, or the name is taken."""
        service = OfferedService(
            name, side_type, self._contents.bottles(name, side_type.name, side_type.type_id), call, self.drop
        )
        with self._lock:
            if name in self._served:
                raise MessageTypeError(
                    f"{name} has the type {self._served[name].side_type.name} on YARP",
                    "rename one of the services with a rule",
                )
            self._served[name] = service
        self._context.changed()
        return service

    def drop(self, service: OfferedService) -> None:
        """Remove a closed service."""
        with self._lock:
            if self._served.get(service.name) is service:
                del self._served[service.name]
        self._context.changed()

"""Services on the YARP side: RPC ports that serve those of the hub, and RPC ports of programs that rules name."""

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
    """Serves one service by an RPC port. A call waits on its connection's own thread; other connections go on.

    Args:
        made_by: tells who made a port.
        refused: called for a request that is refused: service, reason, why.
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
        """Take a request; on the thread of its connection."""
        peer = message.peer
        if self._made_by(peer.route.source) is MadeBy.MIDSPAN:
            self._say(message, CallError("a call of Midspan's own does not come back to it"))
            return
        try:
            request, peer.profile = self._bottles.request_to_hub(message.payload, peer.profile)
        except ConversionError as err:
            self._refused(self.service, "bad", f"from {peer.route.source}: {err}")
            self._say(message, CallError(str(err)))
            return
        message.later()
        with self._lock:
            closed = self._closed
            if not closed:
                self._waiting[message] = nothing
        if closed:
            self._say(message, CallError(f"{self.service} is no longer served"))
            return
        abandon = self._call(request, partial(self._answer, message))
        with self._lock:
            if waits := message in self._waiting:
                self._waiting[message] = abandon
        if not waits:  # who asked went as the call began, or the service did
            abandon()

    def look(self) -> None:
        """Abandon the calls of callers that left."""
        with self._lock:
            waiting = list(self._waiting)
        for message in waiting:
            peer = message.peer
            if isinstance(peer, Input) and peer.is_gone:
                abandon = self._forget(message)
                message.give_up()
                if abandon is not None:
                    abandon()

    def close(self) -> None:
        """End all calls with an error."""
        with self._lock:
            self._closed = True
            waiting, self._waiting = self._waiting, {}
        for message, abandon in waiting.items():
            abandon()
            self._say(message, CallError(f"{self.service} is no longer served"))

    def _answer(self, message: PortMessage, result: bytes | CallError) -> None:
        if self._forget(message) is not None:
            self._say(message, result)

    def _forget(self, message: PortMessage) -> Abandon | None:
        with self._lock:
            return self._waiting.pop(message, None)

    def _say(self, message: PortMessage, result: bytes | CallError) -> None:
        profile = message.peer.profile
        try:
            reply = self._bottles.reply_to_yarp(result, profile)
        except ConversionError as err:
            _log.warning("%s: the reply cannot be said on YARP: %s", self.service, err)
            reply = self._bottles.reply_to_yarp(CallError(str(err)), profile)
        message.reply(reply)


# -- RPC ports of programs, each call on a connection of its own -------------------------------------------------------

MOST = 64
"""Calls of one port that are under way at most."""

_NUMBERS = itertools.count(1)
_IDLE = 4
"""Connections that are kept for the next calls."""


class PortCaller:
    """Calls one RPC port (`bridge.routing.edge.EdgeCaller`); ``carrier`` is "" for the usual one."""

    def __init__(self, naming: NameClient, port: str, carrier: str, bottles: CallBottles, limit: int) -> None:
        self._naming, self._names, self._port = naming, Unregistered(naming), port
        self._target = f"{carrier}:/{port}" if carrier else port
        self._bottles, self._limit = bottles, limit
        self._lock = threading.Lock()
        self._idle: deque[PortCore] = deque()
        self._calls: set[_PortCall] = set()
        self._closed = False

    def call(self, request: bytes, done: Done) -> Abandon:
        """Begin a call; see `EdgeCaller.call`."""
        with self._lock:
            trouble = ""
            if self._closed:
                trouble = f"{self._port} is no longer called"
            elif len(self._calls) >= MOST:
                trouble = f"{self._port} is busy: {MOST} calls are under way"
            else:
                asked = _PortCall(self, request, done)
                self._calls.add(asked)
                core = self._idle.popleft() if self._idle else None
        if trouble:
            done(CallError(trouble))
            return nothing
        threading.Thread(target=asked.run, args=(core,), name=f"midspan-yarp-call {self._port}", daemon=True).start()
        return asked.abandon

    def close(self) -> None:
        """End every call with an error; see `EdgeCaller.close`."""
        with self._lock:
            self._closed = True
            calls, idle = list(self._calls), list(self._idle)
            self._idle.clear()
        for asked in calls:
            asked.end(CallError(f"{self._port} is no longer called"))
        for core in idle:
            core.close()

    def connection(self) -> PortCore:
        """A port of ours that is connected to theirs; raises `OSError`."""
        if self._naming.get_property(self._port, OWNER):
            raise ConnectionRefusedError(f"{self._port} is a port of Midspan's; what it serves is not taken up again")
        name = f"/midspan/call{next(_NUMBERS)}/{os.getpid()}"
        core = PortCore(name, naming=self._names, rpc=True, is_input=False, limit=self._limit)
        core.open()
        done, problem = core.add_output(self._target)
        if not done:
            core.close()
            raise ConnectionRefusedError(problem)
        return core

    def ask(self, core: PortCore, request: bytes) -> bytes:
        """One request and its reply, as the hub's bytes.

        Raises:
            OSError: the connection broke.
            WireError: the reply is no Bottle.
            ConversionError: it is none of this service's.
            CallError: it tells of a failure.
        """
        profile = core.answers_in
        reply = core.request(self._bottles.request_to_yarp(request, profile))
        return self._bottles.reply_to_hub(reply, profile)

    def over(self, asked: _PortCall, core: PortCore | None) -> None:
        """A call ended; its connection may serve the next one."""
        with self._lock:
            self._calls.discard(asked)
            keep = core is not None and not self._closed and len(self._idle) < _IDLE
            if keep and core is not None:
                self._idle.append(core)
        if core is not None and not keep:
            core.close()


class _PortCall:
    """One call, on a thread of its own."""

    def __init__(self, caller: PortCaller, request: bytes, done: Done) -> None:
        self._caller, self._request = caller, request
        self._lock = threading.Lock()
        self._done: Done | None = done
        self._core: PortCore | None = None

    def run(self, core: PortCore | None) -> None:
        """Call and hand on the reply. An earlier call's connection may have died: then a new one is made."""
        result: bytes | CallError
        fresh: PortCore | None = None
        try:
            if core is not None and not core.connections.outputs:
                core.close()
                core = None
            fresh = core or self._caller.connection()
            with self._lock:
                self._core = fresh if self._done is not None else None
            if self._core is None:
                self._caller.over(self, fresh)
                return
            result = self._caller.ask(fresh, self._request)
        except CallError as err:
            result = err
        except ConversionError as err:
            result = CallError(f"the reply is malformed: {err}")
        except (OSError, WireError) as err:
            result = CallError(f"the port left before it answered: {err}")
            if fresh is not None:
                fresh.close()
                fresh = None
        with self._lock:
            self._core = None
        self.end(result)
        self._caller.over(self, fresh)

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


# -- all of them ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class OfferedService:
    """A service of the hub that YARP programs may call."""

    name: str
    side_type: SideType
    bottles: CallBottles
    call: Call
    drop: Callable[[OfferedService], None]

    def close(self) -> None:
        """Serve no more; the port answers what it was asked with an error. Safe to call twice."""
        self.drop(self)


class YarpServices:
    """The services that are served and called. Methods may be called from any thread."""

    def __init__(self, context: YarpContext) -> None:
        self._context, self._contents, self._registry = context, context.contents, context.registry
        self._lock = threading.Lock()
        self._served: dict[str, OfferedService] = {}

    def called(self) -> list[tuple[str, str, str]]:
        """Port, service and type of each port that a rule names."""
        return [(rule.port, rule.service, rule.type) for rule in self._contents.called if rule.port and rule.type]

    def served(self) -> dict[str, OfferedService]:
        """The services that YARP programs may call, by name."""
        with self._lock:
            return dict(self._served)

    def plan(self, served: Mapping[str, OfferedService]) -> dict[str, PortPlan]:
        """The ports that services need."""
        found: dict[str, PortPlan] = {}
        for service in served.values():
            port = self._context.names.rpc(service.name)
            request, reply = self._contents.of_service(service.name)
            found[port] = PortPlan(port, False, service.name, service.side_type.name, "", request, reply=reply)
        return found

    def conversion(self, type_name: str, type_hash: str = "") -> ServiceConversion:
        """Checks of requests and replies; the ports convert them, each to its own content."""
        known = self._registry.service_ros2(type_name, type_hash)
        request, response = self._registry.hub_service_check(type_name, type_hash)
        return ServiceConversion(known, known, request, None, response, None)

    def caller(self, name: str, side_type: SideType) -> PortCaller:
        """Call the port that a rule names; raises `MessageTypeError` without such a rule."""
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
                    f"{name} is {self._served[name].side_type.name} on YARP already",
                    "rename one of the services by a rule",
                )
            self._served[name] = service
        self._context.changed()
        return service

    def drop(self, service: OfferedService) -> None:
        """A server is closed."""
        with self._lock:
            if self._served.get(service.name) is service:
                del self._served[service.name]
        self._context.changed()

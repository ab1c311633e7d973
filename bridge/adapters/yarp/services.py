"""The services of the YARP side: the hub's, which YARP programs call by RPC ports, and RPC ports that rules name."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from bridge.adapters.base import EdgeCaller, EdgeServer
from bridge.adapters.yarp.asking import PortCaller
from bridge.adapters.yarp.call_bottles import CallBottles
from bridge.adapters.yarp.contents import Contents
from bridge.adapters.yarp.names import PortNames
from bridge.adapters.yarp.plan import PortPlan
from bridge.hub.call import Call
from bridge.messages.conversion import ServiceConversion, SideType
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from yarp_compat.naming.client import NameClient


@dataclass(frozen=True, slots=True, eq=False)
class Service:
    """A service of the hub that YARP programs may call."""

    name: str
    side_type: SideType
    bottles: CallBottles
    call: Call


class Services:
    """What is served and called. Methods may be called from any thread.

    Args:
        contents: the rules.
        registry: of types.
        naming: the name server.
        limit: bytes of the largest reply.
        changed: called when there is a port more or less to be had.
    """

    def __init__(
        self, contents: Contents, registry: Registry, naming: NameClient, limit: int, changed: Callable[[], None]
    ) -> None:
        self._contents, self._registry, self._naming = contents, registry, naming
        self._limit, self._changed = limit, changed
        self._lock = threading.Lock()
        self._served: dict[str, Service] = {}

    def called(self) -> list[tuple[str, str, str]]:
        """Port, service and type of each port that a rule names."""
        return [(rule.port, rule.service, rule.type) for rule in self._contents.called if rule.port and rule.type]

    def served(self) -> dict[str, Service]:
        """The services that YARP programs may call, by name."""
        with self._lock:
            return dict(self._served)

    def plan(self, names: PortNames, served: Mapping[str, Service]) -> dict[str, PortPlan]:
        """The ports that services need."""
        found: dict[str, PortPlan] = {}
        for service in served.values():
            port = names.rpc(service.name)
            request, reply = self._contents.of_service(service.name)
            found[port] = PortPlan(port, False, service.name, service.side_type.name, "", request, reply=reply)
        return found

    def conversion(self, type_name: str, type_hash: str = "") -> ServiceConversion:
        """Requests and replies are checked; what each port carries is made of them, and of what comes they are made."""
        known = self._registry.service_ros2(type_name, type_hash)
        request, response = self._registry.hub_service_check(type_name, type_hash)
        return ServiceConversion(known, known, request, None, response, None)

    def caller(self, name: str, side_type: SideType) -> EdgeCaller:
        """Call the port that a rule names; raises `MessageTypeError` where none does."""
        rule = self._contents.served_by(name)
        if rule is None or rule.port is None:
            msg = f"no rule of yarp.services names a port for {name}"
            raise MessageTypeError(msg)
        bottles = self._contents.bottles(name, side_type.name, side_type.type_id)
        return PortCaller(self._naming, rule.port, rule.carrier or "", bottles, self._limit)

    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """Serve a service; raises `MessageTypeError` where its type cannot be said, or another has the name."""
        service = Service(name, side_type, self._contents.bottles(name, side_type.name, side_type.type_id), call)
        with self._lock:
            if name in self._served:
                msg = f"{name} is {self._served[name].side_type.name} on YARP already"
                raise MessageTypeError(msg, "rename one of the services by a rule")
            self._served[name] = service
        self._changed()
        return _Server(self, service)

    def drop(self, service: Service) -> None:
        """A server is closed."""
        with self._lock:
            if self._served.get(service.name) is service:
                del self._served[service.name]
        self._changed()


class _Server:
    """See `EdgeServer`."""

    def __init__(self, services: Services, service: Service) -> None:
        self._services, self._service = services, service

    def close(self) -> None:
        """Serve no more; the port answers what it was asked with an error. Safe to call twice."""
        self._services.drop(self._service)

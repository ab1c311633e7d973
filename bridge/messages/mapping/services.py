"""Services of ROS 1 and ROS 2: their definitions, their counterparts, and the conversion of their messages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bridge.messages.definitions.hashes import EMPTY_MD5, md5_sum, rihs01
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name, legal_type, split_part
from bridge.messages.definitions.parts import CANCEL_GOAL, CONTENTS, generated_parts, is_service
from bridge.messages.definitions.schema import Definition, Schema, World
from bridge.messages.definitions.text import closure, full_text
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.fields import has_equal_fields
from bridge.messages.mapping.messages import MessageMapping, derive_ros1, derive_ros2, unknown_type
from bridge.messages.transcode.conversion import ServiceConversion, SideType


@dataclass(frozen=True)
class ServiceSchema:
    """A service type of ROS 1 or ROS 2."""

    name: str  #: as its world spells it
    type_id: str
    request: Schema  #: the request's message, named ``pkg/srv/Name_Request`` in both worlds
    response: Schema

    @property
    def side_type(self) -> SideType:
        """The type as announced on its side, or on the hub."""
        text = f"{full_text(self.request)}---\n{full_text(self.response)}"
        return SideType(self.name, self.type_id, text)


def ros1_service(name: str, request: Schema, response: Schema) -> ServiceSchema:
    """Return the ROS 1 service with this request and response."""
    return ServiceSchema(name, md5_sum(request, response), request, response)


def ros2_service(root: Schema) -> ServiceSchema:
    """Return the ROS 2 service that a schema describes; raises `MessageTypeError` if it does not describe one."""
    if any(f"{root.name}_{part}" not in root.types for part in CONTENTS["srv"]):
        raise MessageTypeError(f"the announced definition of {root.name} is not that of a service")
    request, response = (root.sub(f"{root.name}_{part}") for part in CONTENTS["srv"])
    return ServiceSchema(root.name, rihs01(root), request, response)


class ServiceMapping:
    """The registry's services; the registry holds the lock. Raises `MessageTypeError` for services it cannot map."""

    def __init__(self, messages: MessageMapping) -> None:
        self._messages = messages

    def of_ros1(self, name: str, md5: str = "") -> ServiceSchema:
        """Return the ROS 1 service ``pkg/Name``, derived from the ROS 2 service if only ROS 2 has it."""
        if name == CANCEL_GOAL:
            return self._derive_ros1(self.of_ros2(name))
        if not is_ros1_name(name):
            raise unknown_type(name, World.ROS1)
        service = self._find_ros1(name)
        if service is None:
            for candidate in self._messages.rules.ros2_names(name, "srv"):
                ros2 = self._find_ros2(candidate)
                derived = None if ros2 is None else self.to_ros1(ros2)
                if derived is not None and derived.name == name:
                    service = derived
                    break
        if md5 == EMPTY_MD5 and (service is None or service.type_id != md5):
            service = self._empty_ros1(name)
        if service is None or md5 not in ("", service.type_id):
            raise unknown_type(name, World.ROS1, md5, "" if service is None else service.type_id)
        return service

    def of_ros2(self, name: str, type_hash: str = "") -> ServiceSchema:
        """Return the ROS 2 service ``pkg/srv/Name``, derived from the ROS 1 service if only ROS 1 has it."""
        if not is_ros2_name(name) or not is_service(name):
            raise unknown_type(name, World.ROS2)
        service = self._find_ros2(name, type_hash)
        if service is not None:
            return service
        known = " or ".join(self._messages.ros2.fingerprints(name))
        for ros1 in self._ros1_candidates(name):
            ros2 = self.to_ros2(ros1)
            if ros2.name == name:
                if type_hash in ("", ros2.type_id):
                    return ros2
                known = known or ros2.type_id
        raise unknown_type(name, World.ROS2, type_hash, known)

    def part(self, name: str, type_hash: str = "") -> Schema:
        """Return the request or response of a ROS 2 service that is only defined in ROS 1."""
        base, part = split_part(name)
        service = self.of_ros2(base) if part in CONTENTS["srv"] else None
        schema = None if service is None else service.request if part == "Request" else service.response
        if schema is None or type_hash not in ("", rihs01(schema)):
            raise unknown_type(name, World.ROS2, type_hash, "" if schema is None else rihs01(schema))
        return schema

    def to_ros2(self, ros1: ServiceSchema) -> ServiceSchema:
        """Return the ROS 2 service for a ROS 1 service: installed, or announced with equal fields, or else derived."""
        names = [CANCEL_GOAL] if ros1.name == CANCEL_GOAL else self._messages.rules.ros2_names(ros1.name, "srv")
        for name in names:
            root = self._messages.ros2.installed(name)
            if root is not None:
                return ros2_service(root)
        for name in names:
            for root in self._messages.ros2.variants(name):
                announced = ros2_service(root)
                if has_equal_fields(ros1.request, announced.request, self._messages.rules) and has_equal_fields(
                    ros1.response, announced.response, self._messages.rules
                ):
                    return announced
        return self._derive_ros2(ros1)

    def to_ros1(self, ros2: ServiceSchema) -> ServiceSchema:
        """Return the ROS 1 service for a ROS 2 service: the installed one, else a derived one."""
        first: ServiceSchema | None = None
        for ros1 in self._ros1_candidates(ros2.name):
            back = self.to_ros2(ros1)
            if (back.name, back.type_id) == (ros2.name, ros2.type_id):
                return ros1
            first = first or ros1
        return first or self._derive_ros1(ros2)

    def conversion(self, ros1: ServiceSchema, ros2: ServiceSchema) -> ServiceConversion:
        """Return the conversion of requests and responses between two corresponding services."""
        request = self._messages.conversion(ros1.request, ros2.request)
        response = self._messages.conversion(ros1.response, ros2.response)
        return ServiceConversion(
            side=ros1.side_type,
            hub=ros2.side_type,
            request_to_side=self._messages.conversion(ros2.request, ros1.request).convert,
            request_to_hub=request.convert,
            response_to_side=self._messages.conversion(ros2.response, ros1.response).convert,
            response_to_hub=response.convert,
            left_out=(*request.left_out, *response.left_out),
        )

    def names(self, package: str) -> list[str]:
        """Return the ROS 2 services of a package: installed, announced on the hub, or derived from ROS 1 services."""
        known = [name for name in self._messages.ros2.names(package, "srv") if is_service(name)]
        for name in self._messages.ros1.names(package, "srv"):
            ros2 = legal_type(name.replace("/srv/", "/", 1), "srv")
            if ros2 not in known and ros2.startswith(f"{package}/"):
                known.append(ros2)
        return known

    def _find_ros1(self, name: str) -> ServiceSchema | None:
        base = name.replace("/", "/srv/", 1)
        request, response = (self._messages.ros1.installed(f"{base}_{part}") for part in CONTENTS["srv"])
        return ros1_service(name, request, response) if request is not None and response is not None else None

    def _empty_ros1(self, name: str) -> ServiceSchema:
        """Return the definition of a service whose md5 shows that neither its request nor its response has a field."""
        base = name.replace("/", "/srv/", 1)
        request, response = (Definition(f"{base}_{part}", World.ROS1, ()) for part in CONTENTS["srv"])
        return ros1_service(name, closure(request, {}), closure(response, {}))

    def _find_ros2(self, name: str, type_hash: str = "") -> ServiceSchema | None:
        root = self._messages.ros2.find(name, type_hash)
        return None if root is None else ros2_service(root)

    def _ros1_candidates(self, ros2_name: str) -> Iterator[ServiceSchema]:
        """Yield all ROS 1 services that may correspond to a ROS 2 name, the likeliest first."""
        package = ros2_name.split("/", 1)[0]
        names = self._messages.rules.ros1_names(ros2_name)
        others = [name.replace("/srv/", "/", 1) for name in self._messages.ros1.names(package, "srv")]
        names += [name for name in others if name not in names and legal_type(name, "srv") == ros2_name]
        for name in names:
            service = self._find_ros1(name)
            if service is not None:
                yield service

    def _derive_ros2(self, ros1: ServiceSchema) -> ServiceSchema:
        base = legal_type(ros1.name, "srv")
        info = self._messages.ros2.installed("service_msgs/msg/ServiceEventInfo")
        assert info is not None  # rosbags ships it
        types = {**generated_parts(base, World.ROS2), **info.types}
        for ros1_part in (ros1.request, ros1.response):
            types |= derive_ros2(ros1_part, self._messages.to_ros2, f"{base}_{ros1_part.name.rpartition('_')[2]}").types
        return ros2_service(closure(types[base], types))

    def _derive_ros1(self, ros2: ServiceSchema) -> ServiceSchema:
        request = derive_ros1(ros2.request, self._messages.to_ros1, ros2.request.name)
        response = derive_ros1(ros2.response, self._messages.to_ros1, ros2.response.name)
        name = ros2.name if ros2.name == CANCEL_GOAL else ros2.name.replace("/srv/", "/", 1)
        return ros1_service(name, request, response)

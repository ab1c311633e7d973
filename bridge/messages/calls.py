"""Requests and replies of a service as Python values and back; an action's two services are such as well."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from bridge.messages.registry import Registry
from bridge.messages.values import Reader, Writer


class ServiceCodec:
    """The codec of one service.

    Args:
        registry: where the type is looked up.
        type_name: ROS 2 name: ``pkg/srv/Name``, ``pkg/action/Name_SendGoal``, ``pkg/action/Name_GetResult``.
        type_hash: the very definition that is meant, "" for the one known here.

    Attributes:
        type: the service as ROS 2 names it.

    Raises:
        MessageTypeError: the type is unknown.
    """

    reader: ClassVar[type[Reader]] = Reader
    writer: ClassVar[type[Writer]] = Writer

    def __init__(self, registry: Registry, type_name: str, type_hash: str = "") -> None:
        self.type = registry.service_ros2(type_name, type_hash)
        self._request, self._response = registry.service_schemas(type_name, type_hash)
        self._check_request, self._check_response = registry.hub_service_check(type_name, type_hash)

    def request(self, value: Mapping[str, Any]) -> bytes:
        """Encode a request; fields that are missing have their defaults; raises `ConversionError`, naming the field."""
        return self._check_request(self.writer(self._request).message(value))

    def response(self, value: Mapping[str, Any]) -> bytes:
        """Encode a reply, in the same way."""
        return self._check_response(self.writer(self._response).message(value))

    def request_value(self, cdr: bytes) -> dict[str, Any]:
        """Decode a request; raises `ConversionError`."""
        return self.reader(self._request, self._check_request(cdr)).message()

    def response_value(self, cdr: bytes) -> dict[str, Any]:
        """Decode a reply; raises `ConversionError`."""
        return self.reader(self._response, self._check_response(cdr)).message()

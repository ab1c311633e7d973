"""Requests and replies of services as Python values, and the replies of calls that failed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from bridge.messages.definitions.schema import STRING_TYPES, Shape
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter


class ServiceCodec:
    """The codec of one service, by its ROS 2 name: ``pkg/srv/Name``, ``pkg/action/Name_SendGoal``, ``..._GetResult``.

    ``type_hash`` selects a definition; "" selects the one known here. Raises `MessageTypeError` if the type is unknown.
    """

    reader: ClassVar[type[MessageReader]] = MessageReader
    writer: ClassVar[type[MessageWriter]] = MessageWriter

    def __init__(self, registry: Registry, type_name: str, type_hash: str = "") -> None:
        self.type = registry.service_ros2(type_name, type_hash)
        self._request, self._response = registry.service_schemas(type_name, type_hash)
        self._check_request, self._check_response = registry.hub_service_check(type_name, type_hash)

    def request(self, value: Mapping[str, Any]) -> bytes:
        """Encode a request; missing fields get their defaults; raises `ConversionError`, which names the field."""
        return self._check_request(self.writer(self._request).message(value))

    def response(self, value: Mapping[str, Any]) -> bytes:
        """Encode a reply; see `request`."""
        return self._check_response(self.writer(self._response).message(value))

    def request_value(self, cdr: bytes) -> dict[str, Any]:
        """Decode a request; raises `ConversionError`."""
        return self.reader(self._request, self._check_request(cdr)).message()

    def response_value(self, cdr: bytes) -> dict[str, Any]:
        """Decode a reply; raises `ConversionError`."""
        return self.reader(self._response, self._check_response(cdr)).message()


_UNKNOWN = 0  # action_msgs/msg/GoalStatus.STATUS_UNKNOWN: contact with the goal is lost, it may still be executing
_ERROR_MSG = "error_msg"
_REJECTED = 1  # action_msgs/srv/CancelGoal_Response.ERROR_REJECTED


def refusal(registry: Registry, type_name: str, type_hash: str = "") -> Callable[[], bytes] | None:
    """Return a function that creates the reply, in CDR, with which an action's service refuses a call.

    Returns None for other services; raises `MessageTypeError` for an unknown action.
    """
    value = _refusal(type_name)
    if value is None:
        return None
    _, response = registry.service_schemas(type_name, type_hash)
    return lambda: MessageWriter(response).message(value)


def unknown_result(registry: Registry, type_name: str, type_hash: str = "") -> Callable[[str], bytes]:
    """Return a function that creates the GetResult reply in CDR for a goal whose end is unknown, given the reason.

    The reason becomes the result's ``error_msg`` if the result has a string of that name.
    """
    _, response = registry.service_schemas(type_name, type_hash)
    kind = next(field.type for field in response.root.fields if field.name == "result")
    fields = {field.name: field.type for field in response.types[kind.base].fields}
    text = fields.get(_ERROR_MSG)
    has_text = text is not None and text.base in STRING_TYPES and text.shape is Shape.SINGLE

    def reply(why: str) -> bytes:
        result = {_ERROR_MSG: why} if has_text else {}
        return MessageWriter(response).message({"status": _UNKNOWN, "result": result})

    return reply


def _refusal(type_name: str) -> dict[str, Any] | None:
    if type_name == "action_msgs/srv/CancelGoal":
        return {"return_code": _REJECTED}
    if "/action/" in type_name and type_name.endswith("_SendGoal"):
        return {"accepted": False}
    if "/action/" in type_name and type_name.endswith("_GetResult"):
        return {"status": _UNKNOWN}
    return None

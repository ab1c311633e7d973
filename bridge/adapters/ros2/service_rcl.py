"""The calls of rcl for services that rclpy does not offer, by ctypes; see `bridge.adapters.ros2.rcl`.

Requests and replies are `Wire`, whatever the service's type (`bridge.adapters.ros2.service_types`). All of these give
Python's lock away: rmw may wait up to 0.1 s for a client of which it knows only half.
"""

from __future__ import annotations

import struct
from ctypes import CDLL, POINTER, byref, c_bool, c_int32, c_int64, c_void_p, cast, create_string_buffer
from typing import NamedTuple

from bridge.adapters.ros2.rcl import RET_OK, RclError, reset_error
from bridge.adapters.ros2.service_bytes import Incoming, Wire, outgoing

_CLIENT_TAKE_FAILED, _SERVICE_TAKE_FAILED = 501, 601
_TIMEOUT = 2
_GID_BYTES = 16
_REQUEST_ID = struct.Struct(f"@{_GID_BYTES}sq")
"""``rmw_request_id_t``: GID, sequence number."""

_rcl = CDLL("librcl.so")
_libc = CDLL(None)
_rcl.rcl_send_request.argtypes = [c_void_p, POINTER(Wire), POINTER(c_int64)]
_rcl.rcl_take_response.argtypes = [c_void_p, c_void_p, c_void_p]
_rcl.rcl_take_request.argtypes = [c_void_p, c_void_p, c_void_p]
_rcl.rcl_send_response.argtypes = [c_void_p, c_void_p, POINTER(Wire)]
_rcl.rcl_client_set_on_new_response_callback.argtypes = [c_void_p, c_void_p, c_void_p]
_rcl.rcl_service_set_on_new_request_callback.argtypes = [c_void_p, c_void_p, c_void_p]
_rcl.rcl_service_server_is_available.argtypes = [c_void_p, c_void_p, POINTER(c_bool)]
for _name in ("send_request", "take_response", "take_request", "send_response", "service_server_is_available"):
    getattr(_rcl, f"rcl_{_name}").restype = c_int32


class RequestId(NamedTuple):
    """Whose request it is: a GID of the client's, by which its reply finds it, and the client's number."""

    gid: bytes
    number: int


class CallTaker:
    """Takes requests and replies. For one thread."""

    def __init__(self) -> None:
        self._incoming = Incoming()
        self._id = create_string_buffer(_REQUEST_ID.size)

    def request(self, service: int) -> tuple[RequestId, bytes] | None:
        """The next request of ``rcl_service_t *``, None where there is none."""
        code = _rcl.rcl_take_request(service, self._id, self._incoming.pointer)
        return self._taken("rcl_take_request", code, _SERVICE_TAKE_FAILED)

    def response(self, client: int) -> tuple[RequestId, bytes] | None:
        """The next reply to ``rcl_client_t *``, None where there is none."""
        code = _rcl.rcl_take_response(client, self._id, self._incoming.pointer)
        return self._taken("rcl_take_response", code, _CLIENT_TAKE_FAILED)

    def _taken(self, call: str, code: int, nothing: int) -> tuple[RequestId, bytes] | None:
        if code == RET_OK:
            return RequestId(*_REQUEST_ID.unpack(self._id.raw)), self._incoming.payload()
        reset_error()
        if code == nothing:
            return None
        raise RclError(call, code)

    def close(self) -> None:
        """Free the buffer."""
        self._incoming.close()


def send_request(client: int, payload: bytes) -> int:
    """Send CDR bytes by ``rcl_client_t *``; the request's number."""
    number = c_int64()
    code = _rcl.rcl_send_request(client, byref(outgoing(payload)), byref(number))
    if code != RET_OK:
        raise RclError("rcl_send_request", code)
    return number.value


def send_response(service: int, request: RequestId, payload: bytes) -> bool:
    """Send CDR bytes by ``rcl_service_t *``; False where the client cannot be reached."""
    name = create_string_buffer(_REQUEST_ID.pack(*request), _REQUEST_ID.size)
    code = _rcl.rcl_send_response(service, name, byref(outgoing(payload)))
    if code == _TIMEOUT:
        reset_error()
        return False
    if code != RET_OK:
        raise RclError("rcl_send_response", code)
    return True


def has_server(node: int, client: int) -> bool:
    """Whether ``rcl_client_t *`` and a server have found each other."""
    there = c_bool()
    code = _rcl.rcl_service_server_is_available(node, client, byref(there))
    if code != RET_OK:
        raise RclError("rcl_service_server_is_available", code)
    return there.value


def wake_by_responses(client: int, descriptor: int | None) -> None:
    """Have each new reply to ``rcl_client_t *`` counted in an eventfd; None ends it."""
    callback = None if descriptor is None else cast(_libc.eventfd_write, c_void_p)
    code = _rcl.rcl_client_set_on_new_response_callback(client, callback, descriptor)
    if code != RET_OK:
        raise RclError("rcl_client_set_on_new_response_callback", code)


def wake_by_requests(service: int, descriptor: int | None) -> None:
    """Have each new request to ``rcl_service_t *`` counted in an eventfd; None ends it."""
    callback = None if descriptor is None else cast(_libc.eventfd_write, c_void_p)
    code = _rcl.rcl_service_set_on_new_request_callback(service, callback, descriptor)
    if code != RET_OK:
        raise RclError("rcl_service_set_on_new_request_callback", code)

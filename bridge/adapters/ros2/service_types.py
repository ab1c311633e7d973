"""Type support of services made at run time, from a type's name and hash alone, as `bridge.adapters.ros2.types` has it.

A service's request and response get the serializers of `bridge.adapters.ros2.service_bytes`, so that what goes through
rcl are bytes. ``rcl_interfaces/srv/GetParameters``, which rclpy itself needs, lends the rest.

Structures: rosidl_runtime_c/service_type_support_struct.h, rosidl_typesupport_fastrtps_cpp/service_type_support.h,
rosidl_typesupport_introspection_c/service_introspection.h (Jazzy).
"""

from __future__ import annotations

import ctypes
import threading
from ctypes import Structure, addressof, c_char_p, c_uint8, c_void_p
from typing import Any

from bridge.adapters.ros2.service_bytes import Callbacks
from bridge.adapters.ros2.types import (
    DISPATCH,
    FAST_DDS,
    INTROSPECTION,
    FindSupport,
    GetHash,
    Lender,
    Support,
    TypeHash,
    TypeName,
    make_capsule,
)

Hashes = tuple[str, str]


class _ServiceSupport(Structure):
    _fields_ = [
        ("identifier", c_char_p),
        ("data", c_void_p),
        ("find", c_void_p),
        ("request", c_void_p),
        ("response", c_void_p),
        ("event", c_void_p),
        ("create_event", c_void_p),
        ("destroy_event", c_void_p),
        ("type_hash", c_void_p),
        ("description", c_void_p),
        ("sources", c_void_p),
    ]


class _Members(Structure):
    """Of either implementation; Fast DDS's ends before ``event``."""

    _fields_ = [
        ("namespace", c_char_p),
        ("name", c_char_p),
        ("request", c_void_p),
        ("response", c_void_p),
        ("event", c_void_p),
    ]


def _lent() -> _ServiceSupport:
    library = ctypes.CDLL("librcl_interfaces__rosidl_typesupport_c.so")
    lend = library.rosidl_typesupport_c__get_service_type_support_handle__rcl_interfaces__srv__GetParameters
    lend.argtypes, lend.restype = [], c_void_p
    return _ServiceSupport.from_address(lend())


class _Service:
    """One service type's structures; they must live as long as any client or server of the type."""

    def __init__(
        self, lender: Lender, lent: _ServiceSupport, callbacks: Callbacks, of: TypeName, part_hashes: Hashes
    ) -> None:
        self._request, self._response = (
            Support(lender, TypeName.parse(f"{of}_{part}", part_hash), callbacks)
            for part, part_hash in zip(("Request", "Response"), part_hashes, strict=True)
        )
        self._hash = TypeHash(1, (c_uint8 * 32)(*of.digest))
        self._find = FindSupport(self._by_identifier)
        self._get_hash = GetHash(lambda _handle: addressof(self._hash))
        self._members = {
            FAST_DDS: self._made(of, "::", FAST_DDS),
            INTROSPECTION: self._made(of, "__", INTROSPECTION),
        }
        self._handles = {name: self._handle(lent, name) for name in (DISPATCH, FAST_DDS, INTROSPECTION)}

    def _made(self, of: TypeName, joint: str, implementation: bytes) -> _Members:
        parts = [support.handle(implementation) for support in (self._request, self._response)]
        if implementation is INTROSPECTION:
            parts = [support.members for support in (self._request, self._response)]
        return _Members(f"{of.package}{joint}{of.folder}".encode(), of.name.encode(), *parts, None)

    def _handle(self, lent: _ServiceSupport, identifier: bytes) -> _ServiceSupport:
        handle = _ServiceSupport.from_buffer_copy(lent)
        handle.identifier = identifier
        members = self._members.get(identifier)
        handle.data = None if members is None else addressof(members)
        handle.find = ctypes.cast(self._find, c_void_p).value
        handle.request, handle.response = self._request.handle(identifier), self._response.handle(identifier)
        handle.type_hash = ctypes.cast(self._get_hash, c_void_p).value
        return handle

    def _by_identifier(self, _handle: int, identifier: bytes) -> int | None:
        found = self._handles.get(identifier)
        return None if found is None else addressof(found)

    @property
    def pointer(self) -> int:
        """``rosidl_service_type_support_t *`` that dispatches to the others."""
        return addressof(self._handles[DISPATCH])


class ServiceTypes:
    """Service classes for raw use with rclpy's inner module, one per name and hash, kept for the process's life."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._parts: tuple[Lender, _ServiceSupport, Callbacks] | None = None
        self._classes: dict[tuple[str, str], Any] = {}
        self._services: list[_Service] = []

    def service_class(self, type_name: str, type_hash: str, part_hashes: Hashes) -> Any:
        """A class that the inner ``Client`` and ``Service`` accept; raises `MessageTypeError`.

        Args:
            type_name: ``package/srv/Name`` or ``package/action/Name_SendGoal``.
            type_hash: the service's ``RIHS01_<64 hex>``.
            part_hashes: those of its request and its response, which are what DDS endpoints announce.
        """
        with self._lock:
            found = self._classes.get((type_name, type_hash))
            if found is None:
                found = self._classes[type_name, type_hash] = self._make(type_name, type_hash, part_hashes)
            return found

    def _make(self, type_name: str, type_hash: str, part_hashes: Hashes) -> Any:
        name = TypeName.parse(type_name, type_hash)
        if self._parts is None:
            self._parts = Lender(), _lent(), Callbacks()
        service = _Service(*self._parts, name, part_hashes)
        self._services.append(service)
        meta = type("RawService", (type,), {"_TYPE_SUPPORT": make_capsule(service.pointer)})
        return meta(name.name, (), {"__slots__": (), "type_name": type_name})

"""Type support created at run time, from only a type's name and hash.

Raw bytes pass through rcl without being parsed. rcl needs only the type's name, by which DDS endpoints are matched, its
RIHS01 hash, which is announced, and a flag that messages may have any size. So no message package has to be
installed, built or imported: a known type support of an unbounded type (``rcl_interfaces/msg/Log``, which rclpy itself
needs) lends its functions, and its structures are copied with the new name and hash. Fast DDS's TypeObject has the
lender's fields, which does no harm: rmw_fastrtps_cpp does not announce it, and endpoints are matched by name.

Structures: rosidl_runtime_c/message_type_support_struct.h, rosidl_typesupport_fastrtps_cpp/message_type_support.h,
rosidl_typesupport_introspection_c/message_introspection.h.
"""

from __future__ import annotations

import ctypes
import re
import threading
from ctypes import CFUNCTYPE, Structure, addressof, c_bool, c_char_p, c_size_t, c_uint8, c_uint32, c_void_p
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

from typing_extensions import override

from bridge.adapters.ros2.rcl import NOT_COMPILED, Callbacks, is_compiled
from bridge.adapters.ros2.releases import current
from bridge.kernels import CURE
from bridge.messages.errors import MessageTypeError

_NAME = re.compile(r"^([A-Za-z][A-Za-z0-9_]*)/(msg|srv|action)/([A-Za-z][A-Za-z0-9_]*)$")
_HASH = re.compile(r"^RIHS01_([0-9a-f]{64})$")
DISPATCH = b"rosidl_typesupport_c"
FAST_DDS = b"rosidl_typesupport_fastrtps_c"
INTROSPECTION = b"rosidl_typesupport_introspection_c"

AnySupport = TypeVar("AnySupport", bound=Structure)

FindSupport = CFUNCTYPE(c_void_p, c_void_p, c_char_p)
GetHash = CFUNCTYPE(c_void_p, c_void_p)


def _pointers(*names: str) -> list[tuple[str, type[c_void_p]]]:
    return [(name, c_void_p) for name in names]


class TypeSupport(Structure):
    """``rosidl_message_type_support_t``."""

    _fields_ = [("identifier", c_char_p), *_pointers("data", "find", "type_hash", "description", "sources")]


class _FastDdsCallbacks(Structure):
    _fields_ = [
        ("namespace", c_char_p), ("name", c_char_p),
        *_pointers("serialize", "deserialize", "serialized_size", "max_serialized_size", "key"),
    ]  # fmt: skip


class _BufferCallbacks(_FastDdsCallbacks):
    """The callbacks of a release with buffers; the lent type has none, so rmw uses only the inherited callbacks."""

    _fields_ = [("has_buffers", c_bool), *_pointers("serialize_with_endpoint", "deserialize_with_endpoint")]


class _Members(Structure):
    _fields_ = [
        ("namespace", c_char_p), ("name", c_char_p), ("count", c_uint32), ("size", c_size_t), ("has_key", c_bool),
        *_pointers("members", "init", "fini"),
    ]  # fmt: skip


class TypeHash(Structure):
    """``rosidl_type_hash_t``."""

    _fields_ = [("version", c_uint8), ("value", c_uint8 * 32)]


_python = ctypes.pythonapi
_python.PyCapsule_New.argtypes = [c_void_p, c_char_p, c_void_p]
_python.PyCapsule_New.restype = ctypes.py_object


def make_capsule(pointer: int) -> Any:
    """Return a pointer in the capsule that rclpy's classes expect."""
    return _python.PyCapsule_New(pointer, None, None)


def lent_support(kind: str, name: str) -> int:
    """Return a pointer to rclpy's type support of an rcl_interfaces ``message`` (``msg__Log``) or ``service``."""
    library = ctypes.CDLL("librcl_interfaces__rosidl_typesupport_c.so")
    lend = getattr(library, f"rosidl_typesupport_c__get_{kind}_type_support_handle__rcl_interfaces__{name}")
    lend.argtypes, lend.restype = [], c_void_p
    return int(lend())


class Lender:
    """The type support whose functions the created type supports use."""

    def __init__(self) -> None:
        pointer = lent_support("message", "msg__Log")
        self.dispatch = TypeSupport.from_address(pointer)
        find = FindSupport(self.dispatch.find)
        self.fast_dds = TypeSupport.from_address(find(pointer, FAST_DDS))
        self.introspection = TypeSupport.from_address(find(pointer, INTROSPECTION))
        form = _BufferCallbacks if current().has_buffers else _FastDdsCallbacks
        self.callbacks = form.from_address(self.fast_dds.data)
        self.members = _Members.from_address(self.introspection.data)


class TypeName(NamedTuple):
    """``package/folder/Name``, and the 32 bytes of the type's hash."""

    package: str
    folder: str
    name: str
    digest: bytes

    @override
    def __str__(self) -> str:
        return f"{self.package}/{self.folder}/{self.name}"

    @classmethod
    def parse(cls, type_name: str, type_hash: str) -> TypeName:
        """Parse a type's name and hash; raises `MessageTypeError`."""
        name, digest = _NAME.match(type_name), _HASH.match(type_hash)
        if name is None:
            raise MessageTypeError(f"{type_name!r} is not the name of a ROS 2 type (package/msg/Name)")
        if digest is None:
            raise MessageTypeError(f"{type_name}: {type_hash!r} is not a type hash (RIHS01_ and 64 hex digits)")
        return cls(name[1], name[2], name[3], bytes.fromhex(digest[1]))


class TypeStructures:
    """One type's structures, by implementation; they must outlive all endpoints of the type."""

    def __init__(self, name: TypeName) -> None:
        self._hash = TypeHash(1, (c_uint8 * 32)(*name.digest))
        self._find = FindSupport(self._by_identifier)
        self._get_hash = GetHash(lambda _handle: addressof(self._hash))
        self._handles: dict[bytes, Any] = {}

    def _copy(self, lent: AnySupport, data: Structure | None) -> AnySupport:
        handle = type(lent).from_buffer_copy(lent)
        handle.data = None if data is None else addressof(data)
        handle.find = ctypes.cast(self._find, c_void_p).value
        handle.type_hash = ctypes.cast(self._get_hash, c_void_p).value
        return handle

    def _by_identifier(self, _handle: int, identifier: bytes) -> int | None:
        handle = self._handles.get(identifier)
        return None if handle is None else addressof(handle)

    @property
    def pointer(self) -> int:
        """The address of the message's or service's type support that dispatches to the others."""
        return self.handle(DISPATCH)

    def handle(self, identifier: bytes) -> int:
        """Return the address of one implementation's type support."""
        return addressof(self._handles[identifier])


class MessageStructures(TypeStructures):
    """The structures of a message type."""

    def __init__(self, lender: Lender, type_name: TypeName, serializers: Callbacks | None = None) -> None:
        super().__init__(type_name)
        self._callbacks = type(lender.callbacks).from_buffer_copy(lender.callbacks)
        self._callbacks.namespace = f"{type_name.package}::{type_name.folder}".encode()
        self._callbacks.name = type_name.name.encode()
        if serializers is not None:
            self._callbacks.serialize = serializers.serialize
            self._callbacks.deserialize = serializers.deserialize
            self._callbacks.serialized_size = serializers.size
        self._members = _Members.from_buffer_copy(lender.members)
        self._members.namespace = f"{type_name.package}__{type_name.folder}".encode()
        self._members.name = type_name.name.encode()
        self._handles = {
            DISPATCH: self._copy(lender.dispatch, None),
            FAST_DDS: self._copy(lender.fast_dds, self._callbacks),
            INTROSPECTION: self._copy(lender.introspection, self._members),
        }

    @property
    def members(self) -> int:
        """``rosidl_typesupport_introspection_c__MessageMembers *``."""
        return addressof(self._members)


# -- services ----------------------------------------------------------------------------------------------------------
# A service's request and response get the serializers of `bridge.adapters.ros2.rcl`, so that bytes go through rcl.
# ``rcl_interfaces/srv/GetParameters``, which rclpy itself needs, lends the rest.
#
# Structures: rosidl_runtime_c/service_type_support_struct.h, rosidl_typesupport_fastrtps_cpp/service_type_support.h,
# rosidl_typesupport_introspection_c/service_introspection.h (Jazzy).

Hashes = tuple[str, str]


class _ServiceSupport(Structure):
    _fields_ = [("identifier", c_char_p), *_pointers(
        "data", "find", "request", "response", "event", "create_event", "destroy_event", "type_hash", "description",
        "sources",
    )]  # fmt: skip


class _ServiceMembers(Structure):
    """The members structure of either implementation; Fast DDS's structure ends before ``event``."""

    _fields_ = [("namespace", c_char_p), ("name", c_char_p), *_pointers("request", "response", "event")]


class ServiceParts(TypeStructures):
    """The structures of a service's requests and responses, as messages."""

    def __init__(
        self, lender: Lender, type_name: TypeName, part_hashes: Hashes, callbacks: Callbacks | None = None
    ) -> None:
        super().__init__(type_name)
        self._request, self._response = (
            MessageStructures(lender, TypeName.parse(f"{type_name}_{part}", part_hash), callbacks)
            for part, part_hash in zip(("Request", "Response"), part_hashes, strict=True)
        )

    @property
    def request(self) -> int:
        """The address of the type support of its requests."""
        return self._request.pointer

    @property
    def response(self) -> int:
        """The address of the type support of its responses."""
        return self._response.pointer

    @property
    @override
    def pointer(self) -> int:
        return self.request


class ServiceStructures(ServiceParts):
    """The structures of a service type."""

    def __init__(
        self, lender: Lender, lent: _ServiceSupport, callbacks: Callbacks, type_name: TypeName, part_hashes: Hashes
    ) -> None:
        super().__init__(lender, type_name, part_hashes, callbacks)
        self._members = {
            FAST_DDS: self._make_members(type_name, "::", FAST_DDS),
            INTROSPECTION: self._make_members(type_name, "__", INTROSPECTION),
        }
        self._handles = {name: self._handle(lent, name) for name in (DISPATCH, FAST_DDS, INTROSPECTION)}

    @property
    @override
    def pointer(self) -> int:
        return self.handle(DISPATCH)

    def _make_members(self, type_name: TypeName, joint: str, implementation: bytes) -> _ServiceMembers:
        parts = [support.handle(implementation) for support in (self._request, self._response)]
        if implementation is INTROSPECTION:
            parts = [support.members for support in (self._request, self._response)]
        return _ServiceMembers(
            f"{type_name.package}{joint}{type_name.folder}".encode(), type_name.name.encode(), *parts, None
        )

    def _handle(self, lent: _ServiceSupport, identifier: bytes) -> _ServiceSupport:
        handle = self._copy(lent, self._members.get(identifier))
        handle.identifier = identifier
        handle.request, handle.response = self._request.handle(identifier), self._response.handle(identifier)
        return handle


# -- classes -----------------------------------------------------------------------------------------------------------


class TypeSupports:
    """Classes for raw use with rclpy on Fast DDS, one per type name and hash, cached for the life of the process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._for_services: tuple[_ServiceSupport, Callbacks] | None = None
        self._classes: dict[tuple[str, str], Any] = {}
        self._structures: list[TypeStructures] = []

    def message_class(self, type_name: str, type_hash: str) -> Any:
        """Return a class for publishers and raw subscriptions; raises `MessageTypeError`."""
        with self._lock:
            raw_class = self._classes.get((type_name, type_hash))
            if raw_class is None:
                name = TypeName.parse(type_name, type_hash)
                # rclpy reads these from the metaclass; the four functions convert message objects, which raw use never
                # has.
                converters = ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE")
                structures = MessageStructures(self._lender, name, self._serializers())
                raw_class = self._make(name, type_hash, structures, **dict.fromkeys(converters, True))
            return raw_class

    def _serializers(self) -> Callbacks | None:
        """Return the functions that copy the bytes of large messages; None without a compiler."""
        return Callbacks() if is_compiled() else None

    def prepare_services(self) -> None:
        """Load the structures that all services share; raises `MessageTypeError` if services cannot be bridged."""
        with self._lock:
            if self._for_services is None:
                support = _ServiceSupport.from_address(lent_support("service", "srv__GetParameters"))
                self._for_services = support, Callbacks()

    def _service_structures(self, name: TypeName, part_hashes: Hashes) -> ServiceParts:
        assert self._for_services is not None
        return ServiceStructures(self._lender, *self._for_services, name, part_hashes)

    def service_class(self, type_name: str, type_hash: str, part_hashes: Hashes) -> Any:
        """Return a class that rclpy's inner ``Client`` and ``Service`` accept; raises `MessageTypeError`.

        Its ``request_support`` and ``response_support`` are the addresses of the type supports of its two messages.
        The type is ``package/srv/Name`` or ``package/action/Name_SendGoal``. ``part_hashes`` are the hashes of its
        request and its response, which DDS endpoints announce.
        """
        self.prepare_services()
        with self._lock:
            raw_class = self._classes.get((type_name, type_hash))
            if raw_class is None:
                name = TypeName.parse(type_name, type_hash)
                structures = self._service_structures(name, part_hashes)
                supports = {"request_support": structures.request, "response_support": structures.response}
                raw_class = self._make(name, type_hash, structures, **supports)
            return raw_class

    @cached_property
    def _lender(self) -> Lender:
        return Lender()

    def _make(self, name: TypeName, type_hash: str, structures: TypeStructures, **more: int) -> Any:
        self._structures.append(structures)
        meta = type("RawType", (type,), {"_TYPE_SUPPORT": make_capsule(structures.pointer), **more})
        raw_class = self._classes[str(name), type_hash] = meta(name.name, (), {"__slots__": (), "type_name": str(name)})
        return raw_class


class RawTypeSupports(TypeSupports):
    """Classes for Cyclone DDS, whose rmw takes no serializers from the type support.

    A service class has only the type supports of its two messages, for `bridge.adapters.ros2.services.raw`.
    """

    @override
    def _serializers(self) -> None:
        return None

    @override
    def prepare_services(self) -> None:
        if not is_compiled():  # rcl's wait set, which serves subscriptions then, accepts no endpoints of rmw
            raise MessageTypeError(NOT_COMPILED, CURE)

    @override
    def _service_structures(self, name: TypeName, part_hashes: Hashes) -> ServiceParts:
        return ServiceParts(self._lender, name, part_hashes)

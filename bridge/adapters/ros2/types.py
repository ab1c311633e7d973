"""Type support made at run time, from a type's name and hash alone.

Raw bytes pass through rcl without a look at their fields: of a type it needs the name that DDS endpoints are matched
by, the RIHS01 hash that is announced, and the promise that messages may be of any size. So no message package has to
be installed, built or imported: a known type support of an unbounded type (``rcl_interfaces/msg/Log``, which rclpy
itself needs) lends its functions, and its structures are copied with the new name and hash. Fast DDS's TypeObject is
made of the lender's fields; rmw_fastrtps_cpp does not announce it, endpoints are matched by name.

Structures: rosidl_runtime_c/message_type_support_struct.h, rosidl_typesupport_fastrtps_cpp/message_type_support.h,
rosidl_typesupport_introspection_c/message_introspection.h.
"""

from __future__ import annotations

import ctypes
import re
import threading
from ctypes import CFUNCTYPE, Structure, addressof, c_bool, c_char_p, c_size_t, c_uint8, c_uint32, c_void_p
from typing import Any, NamedTuple, Protocol

from bridge.messages.errors import MessageTypeError

_NAME = re.compile(r"^([A-Za-z][A-Za-z0-9_]*)/(msg|srv|action)/([A-Za-z][A-Za-z0-9_]*)$")
_HASH = re.compile(r"^RIHS01_([0-9a-f]{64})$")
DISPATCH = b"rosidl_typesupport_c"
FAST_DDS = b"rosidl_typesupport_fastrtps_c"
INTROSPECTION = b"rosidl_typesupport_introspection_c"

FindSupport = CFUNCTYPE(c_void_p, c_void_p, c_char_p)
GetHash = CFUNCTYPE(c_void_p, c_void_p)


class TypeSupport(Structure):
    """``rosidl_message_type_support_t``."""

    _fields_ = [
        ("identifier", c_char_p),
        ("data", c_void_p),
        ("find", c_void_p),
        ("type_hash", c_void_p),
        ("description", c_void_p),
        ("sources", c_void_p),
    ]


class _FastDdsCallbacks(Structure):
    _fields_ = [("namespace", c_char_p), ("name", c_char_p)] + [
        (name, c_void_p) for name in ("serialize", "deserialize", "serialized_size", "max_serialized_size", "key")
    ]


class _Members(Structure):
    _fields_ = [
        ("namespace", c_char_p),
        ("name", c_char_p),
        ("count", c_uint32),
        ("size", c_size_t),
        ("has_key", c_bool),
        ("members", c_void_p),
        ("init", c_void_p),
        ("fini", c_void_p),
    ]


class TypeHash(Structure):
    """``rosidl_type_hash_t``."""

    _fields_ = [("version", c_uint8), ("value", c_uint8 * 32)]


_python = ctypes.pythonapi
_python.PyCapsule_New.argtypes = [c_void_p, c_char_p, c_void_p]
_python.PyCapsule_New.restype = ctypes.py_object


def make_capsule(pointer: int) -> Any:
    """A pointer as rclpy's classes hold theirs."""
    return _python.PyCapsule_New(pointer, None, None)


class Lender:
    """The type support whose functions the made ones borrow."""

    def __init__(self) -> None:
        library = ctypes.CDLL("librcl_interfaces__rosidl_typesupport_c.so")
        lend = library.rosidl_typesupport_c__get_message_type_support_handle__rcl_interfaces__msg__Log
        lend.argtypes, lend.restype = [], c_void_p
        pointer = lend()
        self.dispatch = TypeSupport.from_address(pointer)
        find = FindSupport(self.dispatch.find)
        self.fast_dds = TypeSupport.from_address(find(pointer, FAST_DDS))
        self.introspection = TypeSupport.from_address(find(pointer, INTROSPECTION))
        self.callbacks = _FastDdsCallbacks.from_address(self.fast_dds.data)
        self.members = _Members.from_address(self.introspection.data)


class TypeName(NamedTuple):
    """``package/folder/Name``, and the 32 bytes of the type's hash."""

    package: str
    folder: str
    name: str
    digest: bytes

    def __str__(self) -> str:
        return f"{self.package}/{self.folder}/{self.name}"

    @classmethod
    def parse(cls, type_name: str, type_hash: str) -> TypeName:
        """Take both apart; raises `MessageTypeError`."""
        name, digest = _NAME.match(type_name), _HASH.match(type_hash)
        if name is None:
            raise MessageTypeError(f"{type_name!r} is not the name of a ROS 2 type (package/msg/Name)")
        if digest is None:
            raise MessageTypeError(f"{type_name}: {type_hash!r} is not a type hash (RIHS01_ and 64 hex digits)")
        return cls(name[1], name[2], name[3], bytes.fromhex(digest[1]))


class Serializers(Protocol):
    """Addresses of functions that rmw is to call for messages, in the form of message_type_support.h."""

    serialize: int
    deserialize: int
    size: int


class Support:
    """One type's structures; they must live as long as any endpoint of the type."""

    def __init__(self, lender: Lender, of: TypeName, serializers: Serializers | None = None) -> None:
        self._hash = TypeHash(1, (c_uint8 * 32)(*of.digest))
        self._callbacks = _FastDdsCallbacks.from_buffer_copy(lender.callbacks)
        self._callbacks.namespace = f"{of.package}::{of.folder}".encode()
        self._callbacks.name = of.name.encode()
        if serializers is not None:
            self._callbacks.serialize = serializers.serialize
            self._callbacks.deserialize = serializers.deserialize
            self._callbacks.serialized_size = serializers.size
        self._members = _Members.from_buffer_copy(lender.members)
        self._members.namespace = f"{of.package}__{of.folder}".encode()
        self._members.name = of.name.encode()
        self._find = FindSupport(self._by_identifier)
        self._get_hash = GetHash(lambda _handle: addressof(self._hash))
        self._handles = {
            DISPATCH: self._handle(lender.dispatch, None),
            FAST_DDS: self._handle(lender.fast_dds, addressof(self._callbacks)),
            INTROSPECTION: self._handle(lender.introspection, addressof(self._members)),
        }

    def _handle(self, lent: TypeSupport, data: int | None) -> TypeSupport:
        handle = TypeSupport.from_buffer_copy(lent)
        handle.data = data
        handle.find = ctypes.cast(self._find, c_void_p).value
        handle.type_hash = ctypes.cast(self._get_hash, c_void_p).value
        return handle

    def _by_identifier(self, _handle: int, identifier: bytes) -> int | None:
        found = self._handles.get(identifier)
        return None if found is None else addressof(found)

    @property
    def pointer(self) -> int:
        """``rosidl_message_type_support_t *`` that dispatches to the others."""
        return self.handle(DISPATCH)

    @property
    def members(self) -> int:
        """``rosidl_typesupport_introspection_c__MessageMembers *``."""
        return addressof(self._members)

    def handle(self, identifier: bytes) -> int:
        """``rosidl_message_type_support_t *`` of one implementation."""
        return addressof(self._handles[identifier])


class TypeSupports:
    """Message classes for raw use with rclpy, one per name and hash, kept for the life of the process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lender: Lender | None = None
        self._classes: dict[tuple[str, str], Any] = {}
        self._supports: list[Support] = []

    def message_class(self, type_name: str, type_hash: str) -> Any:
        """A class that rclpy's publishers and raw subscriptions accept; raises `MessageTypeError`.

        Args:
            type_name: ``package/msg/Name``.
            type_hash: ``RIHS01_<64 hex>``.
        """
        with self._lock:
            found = self._classes.get((type_name, type_hash))
            if found is None:
                found = self._classes[type_name, type_hash] = self._make(type_name, type_hash)
            return found

    def _make(self, type_name: str, type_hash: str) -> Any:
        name = TypeName.parse(type_name, type_hash)
        if self._lender is None:
            self._lender = Lender()
        support = Support(self._lender, name)
        self._supports.append(support)
        capsule = make_capsule(support.pointer)
        # rclpy looks at the class's class; the four functions convert message objects, which raw use never has.
        converters = ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE")
        meta = type("RawType", (type,), {"_TYPE_SUPPORT": capsule, **dict.fromkeys(converters, True)})
        return meta(name.name, (), {"__slots__": (), "type_name": type_name})

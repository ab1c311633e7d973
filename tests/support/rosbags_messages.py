"""Messages as dicts of their fields, encoded by the rosbags library.

rosbags computes ROS 1 bytes, CDR, md5 and RIHS01 without Midspan's code.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_TF = "geometry_msgs/TransformStamped[] transforms\n"


class Messages:
    """The messages of ROS 1 or ROS 2.

    Args:
        ros1: whether to use ROS 1 Noetic's messages; otherwise ROS 2 Jazzy's.
        folders: further ``.msg`` files, as ``<folder>/<package>/msg/<Name>.msg`` or ``<package>/<Name>.msg``.
        texts: further definitions by name, ``package/Name``.
    """

    def __init__(
        self, *, ros1: bool, folders: tuple[Path, ...] = (), texts: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
        if ros1:
            self.store.register(get_types_from_msg(_TF, "tf2_msgs/msg/TFMessage"))
        for name, text in texts.items():
            self.store.register(get_types_from_msg(text, self.full(name)))
        for folder in folders:
            for file in sorted(folder.rglob("*.msg")):
                package = next(part for part in file.relative_to(folder).parts if part != "msg")
                name = f"{package}/msg/{file.stem}"
                if name not in self.store.types:
                    self.store.register(get_types_from_msg(file.read_text(), name))

    def full(self, name: str) -> str:
        """Return ``package/msg/Name`` for ``package/Name``."""
        package, _, short = name.rpartition("/")
        return name if package.endswith("/msg") else f"{package}/msg/{short}"

    def type_id(self, name: str) -> str:
        """Return the md5 of a ROS 1 type, or the RIHS01 of a ROS 2 type."""
        if self.ros1:
            md5: str = self.store.generate_msgdef(self.full(name), ros_version=1)[1]
            return md5
        return str(self.store.hash_rihs01(self.full(name)))

    def encode(self, name: str, values: dict[str, Any]) -> bytes:
        """Return a message's wire bytes; missing fields are zero."""
        message = self._message(self.full(name), values)
        if self.ros1:
            return bytes(self.store.serialize_ros1(message, self.full(name)))
        return bytes(self.store.serialize_cdr(message, self.full(name)))

    def decode(self, name: str, data: bytes) -> dict[str, Any]:
        """Return the fields of a message."""
        read = self.store.deserialize_ros1 if self.ros1 else self.store.deserialize_cdr
        fields: dict[str, Any] = _plain(read(data, self.full(name)))
        return fields

    def _message(self, name: str, values: dict[str, Any]) -> Any:
        fields = self.store.fielddefs[name][1]
        unknown = set(values) - {field for field, _ in fields}
        assert not unknown, f"{name} has no {unknown}"
        return self.store.types[name](**{field: self._value(kind, values.get(field)) for field, kind in fields})

    def _value(self, kind: Any, value: Any) -> Any:
        node, detail = kind
        if node.name == "BASE":
            return value if value is not None else {"string": "", "bool": False}.get(detail[0], 0)
        if node.name == "NAME":
            return self._message(detail, value or {})
        element, size = detail
        items = value if value is not None else [None] * (size if node.name == "ARRAY" else 0)
        listed = [self._value(element, item) for item in items]
        if element[0].name == "BASE" and element[1][0] not in ("string", "bool"):
            return np.array(listed, np.dtype({"octet": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])))
        return listed


def _plain(value: Any) -> Any:
    if hasattr(value, "__dataclass_fields__"):
        return {name: _plain(getattr(value, name)) for name in value.__dataclass_fields__ if name != "__msgtype__"}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value

"""Names of message types and fields in ROS 1 and ROS 2, and how ROS 1's names are made legal in ROS 2.

The rules for ROS 2 are from rosidl_adapter (jazzy, ``rosidl_adapter/parser.py``): packages and fields are lower case
with single underscores and none at the end, messages are CamelCase, constants UPPER_CASE.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

ROS1_PACKAGES = "MIDSPAN_ROS1_PACKAGES"
"""Environment variable with folders of ROS 1's Python packages, separated as in ``PYTHONPATH``."""

MAX_NAME = 200  # maximum characters of a type's name; longer names do not fit the names of defining files
_ROS1_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*")
_ROS2_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*/(?:msg|srv|action)/[A-Za-z][A-Za-z0-9_]*")
_XML_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")
_LEGAL_PACKAGE = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")
_LEGAL_MESSAGE = re.compile(r"[A-Z][A-Za-z0-9]*")
_LEGAL_CONSTANT = re.compile(r"(?!.*__)(?!.*_$)[A-Z][A-Z0-9_]*")


def package_name(folder: Path) -> str:
    """Return the name in a package's ``package.xml``, or else the name of its folder, with links resolved."""
    try:
        match = _XML_NAME.search((folder / "package.xml").read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        match = None
    return match[1] if match else folder.resolve().name


def is_ros1_name(name: str) -> bool:
    """Whether ``name`` has the form of a ROS 1 message type."""
    return len(name) <= MAX_NAME and _ROS1_NAME.fullmatch(name) is not None


def is_ros2_name(name: str) -> bool:
    """Whether ``name`` has the form of a ROS 2 type: a message, service or action, or a part of these."""
    return len(name) <= MAX_NAME and _ROS2_NAME.fullmatch(name) is not None


def split_part(name: str) -> tuple[str, str]:
    """Split a ROS 2 name into a service or action and its part: ``pkg/srv/Name``, ``Request``; "" for no part."""
    package, kind, short = name.split("/")
    base, _, part = short.partition("_")
    return f"{package}/{kind}/{base}", part


def ros2_candidates(ros1_name: str, kind: str = "msg") -> list[str]:
    """Return ROS 2 names that a ROS 1 message, service (``srv``) or ``action`` may have, the likeliest first."""
    package, name = ros1_name.split("/")
    candidates = [f"{package}/{kind}/{name}"]
    if package.endswith("_msgs"):
        candidates.append(f"{package.removesuffix('_msgs')}_interfaces/{kind}/{name}")
    candidates.append(legal_type(ros1_name, kind))
    return list(dict.fromkeys(candidates))


def ros1_candidates(ros2_name: str) -> list[str]:
    """Return ROS 1 names that a ROS 2 message, service or action may have, the likeliest first; none for parts."""
    package, kind, name = ros2_name.split("/")
    if kind != "msg" and split_part(ros2_name)[1]:
        return []
    candidates = [f"{package}/{name}"]
    if package.endswith("_interfaces"):
        candidates.append(f"{package.removesuffix('_interfaces')}_msgs/{name}")
    return candidates


def legal_package(name: str) -> str:
    """Return the package's name, made legal in ROS 2."""
    return name if _LEGAL_PACKAGE.fullmatch(name) else _snake(name.lower())


def legal_type(ros1_name: str, kind: str = "msg") -> str:
    """Return the ROS 2 name for a type derived from ROS 1: ``my_msgs/my_type`` becomes ``my_msgs/msg/MyType``."""
    package, name = ros1_name.split("/")
    if not _LEGAL_MESSAGE.fullmatch(name):
        name = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    return f"{legal_package(package)}/{kind}/{name}"


def is_legal_field(name: str) -> bool:
    """Whether ROS 2 allows a field of this name."""
    return _LEGAL_PACKAGE.fullmatch(name) is not None


def is_legal_constant(name: str) -> bool:
    """Whether ROS 2 allows a constant of this name."""
    return _LEGAL_CONSTANT.fullmatch(name) is not None


def is_legal_type(name: str) -> bool:
    """Whether ROS 2 allows a message's package and short name: ``my_msgs/msg/Thing``, not ``MyMsgs/msg/a_thing``."""
    package, _, short = name.split("/")
    return _LEGAL_PACKAGE.fullmatch(package) is not None and is_legal_message(short)


def is_legal_message(name: str) -> bool:
    """Whether ROS 2 allows a message of this short name."""
    return _LEGAL_MESSAGE.fullmatch(name) is not None


def legal_fields(names: Iterable[str]) -> dict[str, str]:
    """Return the legal ROS 2 name of each ROS 1 field of one message.

    Legal names stay as they are. Others are made legal, with ``_2``, ``_3`` and so on if the legal name is in use:
    ``T`` becomes ``t_2`` if there is a ``t``.
    """
    return _distinct(names, lambda name: _snake(name.lower()))


def legal_constants(names: Iterable[str]) -> dict[str, str]:
    """Return the legal ROS 2 name of each ROS 1 constant of one message."""
    return _distinct(names, lambda name: name if is_legal_constant(name) else _snake(name.lower()).upper())


def _distinct(names: Iterable[str], change: Callable[[str], str]) -> dict[str, str]:
    names = list(names)
    taken = {name for name in names if change(name) == name}
    result: dict[str, str] = {}
    for name in names:
        wanted = legal = change(name)
        if legal == name:
            result[name] = name
            continue
        number = 2
        while legal in taken:
            legal = f"{wanted}_{number}"
            number += 1
        taken.add(legal)
        result[name] = legal
    return result


def _snake(name: str) -> str:
    return re.sub(r"__+", "_", name).strip("_") or "value"

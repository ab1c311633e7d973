"""ROS messages for YARP scripts: classes made from ``.msg`` files on first use, without any ROS library.

As in C++'s ``yarp::rosmsg``, a class is ``yarp.rosmsg.geometry_msgs.Twist``, or ``get("geometry_msgs/Twist")``. `add`
adds a definition without a file; `folders` is a list of additional folders to search.
"""

from __future__ import annotations

from yarp_compat.rosmsg.definition import DefinitionError
from yarp_compat.rosmsg.library import LIBRARY
from yarp_compat.rosmsg.message import Message, TickTime

add = LIBRARY.add
folders = LIBRARY.folders
get = LIBRARY.get


class _Package:
    """A ROS package, with the classes of its messages as attributes."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> type[Message]:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return get(f"{self._name}/{name}")
        except DefinitionError as err:
            raise AttributeError(str(err)) from None


def __getattr__(name: str) -> _Package:
    if name.startswith("_") or not name.isidentifier():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _Package(name)


__all__ = ["DefinitionError", "Message", "TickTime", "add", "folders", "get"]

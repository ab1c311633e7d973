"""``QosStyle``: the priority of a connection's packets (`yarp/os/QosStyle.h`)."""

from __future__ import annotations

from collections.abc import Iterable

from yarp_compat.ports.service import DSCP, PRIORITIES
from yarp_compat.wire.accessors import getter, setter

_LEVELS = {
    "PacketPriorityInvalid": -1,
    "PacketPriorityNormal": PRIORITIES["NORM"],
    "PacketPriorityLow": PRIORITIES["LOW"],
    "PacketPriorityHigh": PRIORITIES["HIGH"],
    "PacketPriorityCritical": PRIORITIES["CRIT"],
    "PacketPriorityUndefined": 0x7FFF,
}
_CLASSES = {"DSCP_Invalid": -1, **{f"DSCP_{name}": number for name, number in DSCP.items()}, "DSCP_Undefined": 0x7FFF}
_LARGEST = 63  # the largest class of service


class QosStyle:
    """The type of service of packets, and the priority of the sending thread; -1: unchanged."""

    def __init__(self) -> None:
        self._tos = -1
        self._priority = -1
        self._policy = -1

    setPacketPrioritybyTOS = setter("_tos", int, "Set the type of service, the byte in the packet header.")
    setPacketPriorityByTOS = setPacketPrioritybyTOS
    getPacketPriorityAsTOS = getter("_tos", int, "The type of service; -1 if not set.")
    setThreadPriority = setter("_priority", int, "Set the thread's priority, which has no effect in Python.")
    getThreadPriority = getter("_priority", int, "The thread's priority.")
    setThreadPolicy = setter("_policy", int, "Set the thread's policy, which has no effect in Python.")
    getThreadPolicy = getter("_policy", int, "The thread's policy.")

    def setPacketPriorityByDscp(self, dscp: int) -> None:
        """Set the class of service."""
        self._tos = dscp << 2 if 0 <= dscp <= _LARGEST else -1

    setPacketPriorityByLevel = setPacketPriorityByDscp

    def setPacketPriority(self, priority: str) -> bool:
        """Set ``LEVEL:HIGH`` (or LOW, NORM, CRIT), ``DSCP:AF41`` or ``TOS:144``; return False for other text."""
        kind, _, value = priority.partition(":")
        if kind == "TOS" and value.isdecimal():
            self._tos = int(value)
            return True
        classes = {"LEVEL": PRIORITIES, "DSCP": DSCP}
        self.setPacketPriorityByDscp(classes.get(kind, {}).get(value, -1))
        return self._tos >= 0

    def getPacketPriorityAsDSCP(self) -> int:
        """Return the class of service, such as ``QosStyle.DSCP_AF41``; -1 if not set, ``DSCP_Undefined`` for others."""
        return self._class_in(DSCP.values())

    def getPacketPriorityAsLevel(self) -> int:
        """Return YARP's level, such as ``QosStyle.PacketPriorityHigh``, like `getPacketPriorityAsDSCP`."""
        return self._class_in(PRIORITIES.values())

    def _class_in(self, classes: Iterable[int]) -> int:
        if self._tos < 0:
            return -1
        return self._tos >> 2 if self._tos in [number << 2 for number in classes] else _CLASSES["DSCP_Undefined"]


for _name, _number in (*_LEVELS.items(), *_CLASSES.items()):  # as YARP's bindings name enumerations inside a class
    setattr(QosStyle, _name, _number)

"""Connections of mcast: a port sends each message once, to a group, and all members receive it.

The name server gives out the group, one for each port and network interface that it writes by; it goes with the last of
those connections. The one who connects names the group behind its introduction and closes; nothing is answered. After
that there are datagrams as with udp. (``McastCarrier.cpp``, ``DgramTwoWayStream.cpp``, and captures of 4.0)
"""

from __future__ import annotations

import contextlib
import ipaddress
import logging
import os
import selectors
import socket
import struct
import threading

from yarp_compat.ports.base import PortBase
from yarp_compat.ports.datagrams import ROOM, DatagramInput, SendingGroup
from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.naming import Naming
from yarp_compat.ports.sockets import closed_on_failure
from yarp_compat.wire.carriers import CarrierError, Group, Opening
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.datagrams import Assembler
from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
_MOST_SENDERS = 4
"""Programs of one machine whose datagrams are put together at a time: a sender's socket may change under its name."""


class GroupInput(DatagramInput):
    """An input of mcast; closes ``caller``, which named the group; raises `OSError` where it cannot join that."""

    def __init__(self, port: PortBase, caller: socket.socket, opened: Opening, address: tuple[str, int]) -> None:
        assert opened.group is not None
        with caller:
            super().__init__(port, _joined(opened.group, caller.getsockname()[0]), opened, address)
        self.sock.setblocking(False)
        self._assemblers: dict[tuple[str, int], Assembler] = {}
        self._spoiled = self._incomplete = 0  # of those that made room
        self._waker, self._woken = socket.socketpair()
        self._waiting_for = selectors.DefaultSelector()
        for sock in (self.sock, self._woken):
            self._waiting_for.register(sock, selectors.EVENT_READ)

    def start(self, loop: PortLoop) -> None:  # noqa: ARG002
        """Wait for datagrams, on a thread of its own from the first."""
        self._begin()

    def wake(self) -> None:
        """Wake threads that wait for datagrams: the connection has ended; nothing is sent to the group for that."""
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def take(self) -> bool:
        """Take messages until the connection is closed."""
        try:
            return super().take()
        finally:
            self._release()

    def abandon(self) -> None:
        """Close the sockets, where no thread has them yet, or none any more."""
        self._release()
        super().abandon()

    def _release(self) -> None:
        self._waiting_for.close()
        self._waker.close()
        self._woken.close()

    def _receive(self, memory: memoryview) -> tuple[int, tuple[str, int]]:
        while not self._closing:
            with contextlib.suppress(BlockingIOError):
                return super()._receive(memory)
            self._waiting_for.select()
        return 0, ("", 0)

    def _assembler_of(self, sender: tuple[str, int]) -> Assembler:
        found = self._assemblers.get(sender)
        if found is None:
            if len(self._assemblers) >= _MOST_SENDERS:
                gone = self._assemblers.pop(next(iter(self._assemblers)))
                self._spoiled += gone.spoiled
                self._incomplete += gone.incomplete
            found = self._assemblers[sender] = Assembler(self.port.limit)
        return found

    def _count(self, assembler: Assembler) -> None:  # noqa: ARG002
        present = self._assemblers.values()
        self.counters.dropped["checksum"] = self._spoiled + sum(a.spoiled for a in present)
        self.counters.dropped["incomplete"] = self._incomplete + sum(a.incomplete for a in present)


def _joined(group: Group, interface: str) -> socket.socket:
    """A socket that takes a group's datagrams from the network of one of this machine's addresses."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with closed_on_failure(made):
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # several of one machine may take them
        with contextlib.suppress(OSError):
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
        # Bound to the group, it does not get the datagrams of others on the same port; Windows cannot do that.
        made.bind((group[0] if os.name == "posix" else "", group[1]))
        member = struct.pack("4s4s", socket.inet_aton(group[0]), socket.inet_aton(interface))
        made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
    return made


class SendingGroups:
    """The groups that a port writes to, by the addresses of this machine that reach their readers."""

    def __init__(self, naming: Naming) -> None:
        self._naming = naming
        self._lock = threading.Lock()
        self._groups: dict[str, SendingGroup] = {}

    def join(self, owner: str, interface: str, profile: Profile) -> SendingGroup:
        """The group for one more reader, which this machine reaches from ``interface``; `leave` is due for each.

        Raises `CarrierError` where the name server gives none or the readers' dialects differ, `OSError` as it and
        sockets do.
        """
        with self._lock:
            group = self._groups.get(interface) or self._new(owner, interface)
            if group.profile not in (None, profile):
                msg = "the readers of mcast get the same bytes: one of YARP 3 and one of YARP 4 cannot share them"
                raise CarrierError(f"{msg}; connect it by udp or tcp")
            group.profile = profile
            group.readers += 1
            self._groups[interface] = group
            return group

    def _new(self, owner: str, interface: str) -> SendingGroup:
        # A name of the port's own: /tmp/port/1 would go to another port where the name server forgot who has it, and
        # what the port `owns` is unregistered with it.
        name = f"{owner.replace('@', '/')}/mcast/{interface}"
        contact = self._naming.register(name, carrier="mcast")
        group: SendingGroup | None = None
        try:
            group = SendingGroup(contact.name, _group_of(contact, interface), interface)
            others = (other.name for other in self._groups.values())
            self._naming.set_property(owner, "owns", group.name, *others)
            self._naming.announce(contact.name)
        except BaseException:
            if group is not None:
                group.close()
            self._forget(contact.name)
            raise
        _log.info("port %s writes to the multicast group %s:%d by %s", owner, *group.address, interface)
        return group

    def leave(self, group: SendingGroup) -> None:
        """One reader less; the group of the last one is given back."""
        with self._lock:
            group.readers -= 1
            if group.readers > 0:
                return
            if self._groups.get(group.interface) is group:
                del self._groups[group.interface]
            group.close()
            self._forget(group.name)

    def _forget(self, name: str) -> None:
        try:
            self._naming.unregister(name)
        except OSError as error:
            _log.warning("the multicast group %s could not be given back: %s", name, error)

    def abandon(self) -> None:
        """Let go of the sockets, and say nothing to anybody."""
        for group in self._groups.values():
            group.close()


def _group_of(contact: PortContact, interface: str) -> Group:
    with contextlib.suppress(ValueError):
        if ":" not in interface and 0 < contact.port <= 0xFFFF and ipaddress.IPv4Address(contact.host).is_multicast:
            return contact.host, contact.port
    where = f"{contact.host} port {contact.port}, from {interface}"
    raise CarrierError(f"the name server gives out no multicast group of IPv4 ({where}); connect it by udp or tcp")

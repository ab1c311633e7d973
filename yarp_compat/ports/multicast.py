"""Connections over mcast: a port sends each message once, to a group, and all members receive it.

The name server allocates a group for each port and network interface that the port writes from; the group is released
with its last connection. The writer sends the group's address after its introduction and closes the TCP connection; the
reader sends no answer. Then datagrams follow as with udp. (``McastCarrier.cpp``, ``DgramTwoWayStream.cpp``, and
captures of 4.0)
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

from yarp_compat.overriding import override
from yarp_compat.ports.base import PortBase
from yarp_compat.ports.datagrams import RECEIVE_BUFFER, DatagramInput, SendingGroup
from yarp_compat.ports.loop import PortLoop
from yarp_compat.ports.naming import Naming
from yarp_compat.ports.sockets import closed_on_failure
from yarp_compat.wire.carriers import CarrierError, Group, Opening
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.datagrams import Assembler
from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
_MAX_SENDERS = 4
"""Maximum number of senders whose messages are assembled: a writer that restarts sends from another socket."""


class GroupInput(DatagramInput):
    """An input over mcast. Closes ``caller``, which sent the group's address; raises `OSError` if it cannot join."""

    def __init__(self, port: PortBase, caller: socket.socket, opened: Opening, address: tuple[str, int]) -> None:
        assert opened.group is not None
        with caller:
            super().__init__(port, _member_socket(opened.group, caller.getsockname()[0]), opened, address)
        self.sock.setblocking(False)
        self._assemblers: dict[tuple[str, int], Assembler] = {}
        self._spoiled = self._incomplete = 0  # counts of assemblers that were removed
        self._waker, self._woken = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        for sock in (self.sock, self._woken):
            self._selector.register(sock, selectors.EVENT_READ)

    @override
    def start(self, loop: PortLoop) -> None:
        """Wait for datagrams, from the beginning on the input's own thread."""
        self._begin()

    @override
    def wake(self) -> None:
        """Wake up threads that wait for datagrams, without sending to the group: the connection has ended."""
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    @override
    def handle_messages(self) -> bool:
        try:
            return super().handle_messages()
        finally:
            self._release()

    @override
    def abandon(self) -> None:
        self._release()
        super().abandon()

    def _release(self) -> None:
        self._selector.close()
        self._waker.close()
        self._woken.close()

    @override
    def _receive(self, memory: memoryview) -> tuple[int, tuple[str, int]]:
        while not self._closing:
            with contextlib.suppress(BlockingIOError):
                return super()._receive(memory)
            self._selector.select()
        return 0, ("", 0)

    @override
    def _assembler_of(self, sender: tuple[str, int]) -> Assembler:
        assembler = self._assemblers.get(sender)
        if assembler is None:
            if len(self._assemblers) >= _MAX_SENDERS:
                oldest = self._assemblers.pop(next(iter(self._assemblers)))
                self._spoiled += oldest.spoiled
                self._incomplete += oldest.incomplete
            assembler = self._assemblers[sender] = Assembler(self.port.limit)
        return assembler

    @override
    def _count(self, assembler: Assembler) -> None:
        present = self._assemblers.values()
        self.counters.dropped["checksum"] = self._spoiled + sum(a.spoiled for a in present)
        self.counters.dropped["incomplete"] = self._incomplete + sum(a.incomplete for a in present)


def _member_socket(group: Group, interface: str) -> socket.socket:
    """Return a socket that receives a group's datagrams on the interface with that address."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with closed_on_failure(sock):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # several readers on one machine may share the group
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        # A socket that is bound to its group does not receive datagrams of other groups on the same port. Windows
        # cannot bind it to a group.
        sock.bind((group[0] if os.name == "posix" else "", group[1]))
        member = struct.pack("4s4s", socket.inet_aton(group[0]), socket.inet_aton(interface))
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
    return sock


class SendingGroups:
    """The groups that a port writes to, by this machine's addresses that reach their readers."""

    def __init__(self, naming: Naming) -> None:
        self._naming = naming
        self._lock = threading.Lock()
        self._groups: dict[str, SendingGroup] = {}

    def join(self, owner: str, interface: str, profile: Profile) -> SendingGroup:
        """Return the group for one more reader, reached from the address ``interface``; call `leave` once for each.

        Raises `CarrierError` if the name server allocates no group or the readers' dialects differ, and `OSError` from
        the name server or sockets.
        """
        with self._lock:
            group = self._groups.get(interface) or self._new(owner, interface)
            if group.profile not in (None, profile):
                msg = "readers over mcast receive the same bytes: readers of YARP 3 and YARP 4 cannot share a group"
                raise CarrierError(f"{msg}; use udp or tcp")
            group.profile = profile
            group.readers += 1
            self._groups[interface] = group
            return group

    def _new(self, owner: str, interface: str) -> SendingGroup:
        # The name is derived from the port's, because the name server could give a name such as /tmp/port/1 to another
        # port after it has forgotten the first. Names that the port `owns` are unregistered with the port.
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
            self._unregister(contact.name)
            raise
        _log.info("port %s writes to the multicast group %s:%d from %s", owner, *group.address, interface)
        return group

    def leave(self, group: SendingGroup) -> None:
        """Remove one reader; the removal of the last reader releases the group."""
        with self._lock:
            group.readers -= 1
            if group.readers > 0:
                return
            if self._groups.get(group.interface) is group:
                del self._groups[group.interface]
            group.close()
            self._unregister(group.name)

    def _unregister(self, name: str) -> None:
        try:
            self._naming.unregister(name)
        except OSError as error:
            _log.warning("cannot release the multicast group %s: %s", name, error)

    def abandon(self) -> None:
        """Close the sockets in a forked child process, without unregistering the groups."""
        for group in self._groups.values():
            group.close()


def _group_of(contact: PortContact, interface: str) -> Group:
    with contextlib.suppress(ValueError):
        if ":" not in interface and 0 < contact.port <= 0xFFFF and ipaddress.IPv4Address(contact.host).is_multicast:
            return contact.host, contact.port
    address = f"{contact.host} port {contact.port}, from {interface}"
    raise CarrierError(f"the name server allocated no IPv4 multicast group ({address}); use udp or tcp")

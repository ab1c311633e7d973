"""Hand-written DDS discovery messages, parsed by the RTPS specification, and their receivers."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
from collections.abc import Iterator

import pytest

from bridge.adapters.ros2.graph import spdp

PREFIX = bytes.fromhex("010f4d5350414e0102030405")
GUID = PREFIX + bytes.fromhex("000001c1")
DOMAIN = 230
GROUP_PORT = 7400 + 250 * DOMAIN  # DDSI-RTPS 2.5, 9.6.2.3: PB + DG * domain + d0


def parameters(data: bytes) -> tuple[dict[int, bytes], bytes]:
    """Parse a little-endian parameter list (9.4.2.11); return it and the bytes after its sentinel."""
    result: dict[int, bytes] = {}
    while True:
        pid, length = struct.unpack_from("<HH", data)
        if pid == 1:  # PID_SENTINEL; its length is ignored
            return result, data[4:]
        assert length % 4 == 0, "parameters are multiples of four bytes"
        assert len(data) >= 4 + length
        result[pid], data = data[4 : 4 + length], data[4 + length :]


def data(said: bytes, flags: int) -> tuple[int, bytes]:
    """Return the sequence number of a message's only DATA submessage, and the submessage's QoS and data."""
    # 9.4.4: the header
    protocol, major, minor, vendor, prefix = struct.unpack_from("4sBB2s12s", said)
    assert (protocol, major) == (b"RTPS", 2)
    assert minor >= 1
    assert (vendor, prefix) == (PREFIX[:2], PREFIX)
    # 9.4.5.1: the header of its one submessage
    kind, seen, length = struct.unpack_from("<BBH", said, 20)
    assert kind == 0x15, "DATA"
    assert seen == flags
    body = said[24:]
    assert len(body) == length
    # 9.4.5.4: DATA; entity ids of 9.3.1.5
    extra, to_qos = struct.unpack_from("<HH", body)
    assert extra == 0
    assert body[4:8] == bytes.fromhex("000100c7"), "SPDPbuiltinParticipantReader"
    assert body[8:12] == bytes.fromhex("000100c2"), "SPDPbuiltinParticipantWriter"
    high, low = struct.unpack_from("<iI", body, 12)
    return (high << 32) + low, body[4 + to_qos :]


def test_disposal_equals_the_message_of_a_leaving_participant() -> None:
    number, remaining = data(
        spdp.disposal(PREFIX), 0b1011
    )  # little endian (E), inline QoS (Q), no data (D) but a key (K)
    assert number > 1_000_000, "newer than all messages of the dead participant"
    inline, remaining = parameters(remaining)
    assert inline[0x0070] == GUID, "PID_KEY_HASH"
    assert inline[0x0071] == b"\0\0\0\x03", "PID_STATUS_INFO: disposed and unregistered (9.6.4.9), big endian"
    # 9.4.2.12, 10.2: the key as a parameter list
    assert remaining[:4] == b"\0\x03\0\0", "PL_CDR_LE"
    key, remaining = parameters(remaining[4:])
    assert key == {0x0050: GUID}, "PID_PARTICIPANT_GUID"
    assert remaining == b""


def test_announcement_has_the_address_of_the_real_participant() -> None:
    number, remaining = data(spdp.announcement(PREFIX, DOMAIN, 40), 0b0101)  # little endian, data
    assert number == 1
    assert remaining[:4] == b"\0\x03\0\0", "PL_CDR_LE"
    reported, remaining = parameters(remaining[4:])
    assert remaining == b""
    assert reported[0x0050] == GUID
    assert reported[0x0016][:2] == PREFIX[:2], "PID_VENDORID"
    # 9.3.2: kind, port, 16 bytes of address
    unicast = struct.pack("<iI12s4s", 1, GROUP_PORT + 10 + 2 * 40, b"", bytes((127, 0, 0, 1)))
    group = struct.pack("<iI12s4s", 1, GROUP_PORT, b"", bytes((239, 255, 0, 1)))
    assert (reported[0x0032], reported[0x0033]) == (unicast, group), "PID_METATRAFFIC_UNICAST_ and _MULTICAST_LOCATOR"
    assert struct.unpack("<I", reported[0x0058]) == (0b11,), "only SPDP's own endpoints, so nothing else matches"


@contextlib.contextmanager
def listening(address: str, port: int, interface: str = "") -> Iterator[socket.socket]:
    """Open a socket like a participant's, in the SPDP group of ``interface`` if given."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((address, port))
        if interface:
            group = struct.pack("@4s4si", socket.inet_aton("239.255.0.1"), b"", socket.if_nametoindex(interface))
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        sock.settimeout(5.0)
        yield sock


@pytest.mark.parametrize("participant", [0, spdp.PARTICIPANTS - 1])
def test_all_participants_on_this_machine_receive_it(participant: int) -> None:
    unicast = GROUP_PORT + 10 + 2 * participant  # PB + DG * domain + d1 + PG * participant
    with listening("239.255.0.1", GROUP_PORT, "lo") as group, listening("127.0.0.1", unicast) as participant_socket:
        spdp.send_all([spdp.disposal(PREFIX)], DOMAIN, localhost_only=True)
        assert group.recv(1000) == participant_socket.recv(1000) == spdp.disposal(PREFIX)


class Network:
    """Interfaces lo, eth0 and one without an address; records what is sent through each."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, refuse: str = "") -> None:
        self.names = {1: "lo", 4: "eth0", 7: "down0"}
        self.sent: list[tuple[str, str, int]] = []
        self._refuse = refuse
        self._chosen = ""
        monkeypatch.setattr(socket, "if_nameindex", lambda: list(self.names.items()))
        monkeypatch.setattr(socket, "socket", lambda *_: contextlib.nullcontext(self))

    def setsockopt(self, level: int, option: int, value: bytes) -> None:
        assert (level, option) == (socket.IPPROTO_IP, socket.IP_MULTICAST_IF)
        name = self.names[struct.unpack("@4s4si", value)[2]]
        if name == "down0":
            raise OSError(errno.EADDRNOTAVAIL, "no address")
        self._chosen = name

    def sendto(self, _message: bytes, address: tuple[str, int]) -> None:
        self.sent.append((self._chosen, *address))
        if address[0] == self._refuse:
            raise OSError(errno.ECONNREFUSED, "nobody there")


def groups(network: Network) -> list[str]:
    return [name for name, address, port in network.sent if (address, port) == ("239.255.0.1", GROUP_PORT)]


@pytest.mark.parametrize(("localhost_only", "told"), [(True, ["lo"]), (False, ["lo", "eth0"])])
def test_only_the_interfaces_in_range_are_used(
    monkeypatch: pytest.MonkeyPatch, localhost_only: bool, told: list[str]
) -> None:
    network = Network(monkeypatch)
    spdp.send_all([spdp.disposal(PREFIX)], DOMAIN, localhost_only=localhost_only)
    assert groups(network) == told
    assert {address for _, address, _ in network.sent} == {"239.255.0.1", "127.0.0.1"}, "unicast stays on this machine"


@pytest.mark.parametrize("refuse", ["239.255.0.1", "127.0.0.1"])
def test_a_failed_send_does_not_stop_the_others(monkeypatch: pytest.MonkeyPatch, refuse: str) -> None:
    network = Network(monkeypatch, refuse)
    spdp.send_all([b"one", b"two"], DOMAIN, localhost_only=False)
    assert sorted(set(groups(network))) == ["eth0", "lo"]
    unicast = {port for _, address, port in network.sent if address == "127.0.0.1"}
    assert unicast == {GROUP_PORT + 10 + 2 * number for number in range(spdp.PARTICIPANTS)}


def test_all_participants_of_other_machines_receive_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also other daemons' participants, whose numbers are above 31."""
    network = Network(monkeypatch, refuse="10.0.0.2")
    spdp.send_to(["10.0.0.2", "10.0.0.3"], [b"one"], DOMAIN)
    ports = [GROUP_PORT + 10 + 2 * number for number in range(62)]
    assert network.sent == [("", address, port) for address in ("10.0.0.2", "10.0.0.3") for port in ports]

"""Introductions, messages, commands and datagrams: recorded bytes of real YARP, and round trips."""

from __future__ import annotations

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yarp_compat.wire import carriers, framing
from yarp_compat.wire.carriers import Opening
from yarp_compat.wire.datagrams import LARGEST, Assembler, datagram, split
from yarp_compat.wire.errors import WireError

OPENINGS = {
    "tcp": "59 41 e4 1e 00 00 52 50", "fast_tcp": "59 41 64 1e 00 00 52 50", "udp": "59 41 61 1e 00 00 52 50",
    "text": b"CONNECT ".hex(), "text_ack": b"CONNACK ".hex(), "local": b"LOCALITY".hex(),
}  # fmt: skip
NAMES = st.text(st.characters(min_codepoint=33, exclude_categories=["Cs"]), min_size=1, max_size=40).filter(
    lambda n: " (" not in n
)


@pytest.mark.parametrize("name", OPENINGS)
def test_each_carrier_has_its_opening_bytes(name: str) -> None:
    carrier = carriers.CARRIERS[name]
    assert carrier.opening == bytes.fromhex(OPENINGS[name])
    data = carriers.opening(carrier, "/w")
    assert data == carrier.opening + (b"/w\r\n" if carrier.text else b"\x03\0\0\0/w\0")
    assert carriers.parse_opening(data + b"more") == Opening(carrier, "/w", "", len(data))
    for end in range(len(data)):
        assert carriers.parse_opening(data[:end]) is None


def test_qualifiers_follow_the_senders_name() -> None:
    """Qualifiers are a part of the opening, after the sender's name."""
    carrier, qualifiers = carriers.parse("tcp+recv.portmonitor+type.dll")
    data = carriers.opening(carrier, "/w", qualifiers)
    assert data == b"YA\xe4\x1e\0\0RP" + b"\x21\0\0\0/w (recv portmonitor) (type dll)\0"
    assert carriers.parse_opening(data) == Opening(carriers.TCP, "/w", "(recv portmonitor) (type dll)", len(data))


@pytest.mark.parametrize(
    ("data", "carrier"), [(b"GET / HTTP/1.1", "http"), (b"POST /form", "http"), (b"NAME_SERVER q", "name_ser")]
)
def test_openings_without_a_name_are_parsed(data: bytes, carrier: str) -> None:
    opened = carriers.parse_opening(data)
    assert opened is not None
    assert (opened.carrier.name, opened.size) == (carrier, 0)


@given(st.sampled_from(sorted(OPENINGS)), NAMES)
def test_an_opening_with_any_name_is_parsed(carrier: str, name: str) -> None:
    data = carriers.opening(carriers.CARRIERS[carrier], name)
    opened = carriers.parse_opening(data)
    assert opened is not None
    assert (opened.sender, opened.size) == (name, len(data))


def test_each_carrier_gets_its_answer() -> None:
    def answer(name: str) -> bytes:
        return carriers.answer(Opening(carriers.CARRIERS[name], "/w", "", 0), 10005)

    assert answer("tcp") == answer("fast_tcp") == answer("udp") == bytes.fromhex("59 41 15 27 00 00 52 50")
    assert answer("text") == answer("text_ack") == b"Welcome /w\r\n"
    assert answer("local") == answer("http") == answer("name_ser") == b""


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("shmem", "not supported"),
        ("http", "not supported"),
        ("name_ser", "not supported"),
        ("x", "unknown"),
    ],
)
def test_carriers_without_outputs_are_refused_with_the_supported_ones(name: str, reason: str) -> None:
    with pytest.raises(WireError, match=f"{name}.*{reason}.*use one of tcp, fast_tcp, udp"):
        carriers.parse(name)


@pytest.mark.parametrize(("number", "named"), [(14, "shmem"), (5, "number 5"), (-7777, "number 0")])
def test_openings_of_unsupported_carriers_are_refused(number: int, named: str) -> None:
    with pytest.raises(WireError, match=named):
        carriers.recognize(carriers.frame(7777 + number))


def test_a_message_has_the_annotated_bytes() -> None:
    """The message is ``hello 42 3.5`` as YARP 4.0 sends it."""
    payload = bytes.fromhex(
        "00 01 00 00 03 00 00 00 04 00 00 00 05 00 00 00 68 65 6c 6c 6f 01 00 00 00 2a 00 00 00"
        "14 00 00 00 00 00 00 00 00 00 0c 40"
    )
    head = bytes.fromhex(
        "59 41 0a 00 00 00 52 50 02 01 ff ff ff ff ff ff ff ff 08 00 00 00 29 00 00 00 00 00 00 00"
        "00 00 00 00 7e 44 00 01"
    )
    assert framing.prefix(len(payload)) == head
    command, content = framing.parse(head + payload)
    assert (command.key, command.envelope, bytes(content)) == ("D", "", payload)
    assert bytes.fromhex("59 41 00 00 00 00 52 50") == framing.ACK
    assert (
        bytes.fromhex(
            "59 41 0a 00 00 00 52 50 01 01 ff ff ff ff ff ff ff ff 0a 00 00 00 00 00 00 0002 00 00 00 7e 00 00 01 71 00"
        )
        == framing.QUIT
    )


def test_an_envelope_has_the_annotated_bytes() -> None:
    encoded = bytes.fromhex("18 00 00 00 7e 00 00 01") + b"D 3580 1795143618.02289\0"
    assert framing.with_envelope("D", "3580 1795143618.02289") == encoded
    assert framing.parse_command(encoded) == (framing.PortCommand("D", "D 3580 1795143618.02289"), 32)


@given(
    st.binary(max_size=300),
    st.sampled_from("dDa"),
    st.text(st.characters(min_codepoint=32, exclude_categories=["Cs"]), max_size=40),
)
def test_messages_are_framed_and_parsed(payload: bytes, key: str, envelope: str) -> None:
    data = framing.prefix(len(payload), key, envelope) + payload
    command, content = framing.parse(data)
    assert (command.key, command.envelope, bytes(content)) == (key, envelope, payload)
    with pytest.raises(WireError):
        framing.parse(data[:-1] if payload else data + b"x")


@given(st.lists(st.binary(max_size=20), min_size=1, max_size=254))
def test_blocks_are_concatenated(blocks: list[bytes]) -> None:
    all_blocks = [framing.command_bytes("D"), *blocks]
    head = framing.INDEX + bytes([len(all_blocks), 1]) + b"\xff" * 8
    data = head + struct.pack(f"<{len(all_blocks)}i", *map(len, all_blocks)) + bytes(4) + b"".join(all_blocks)
    assert bytes(framing.parse(data)[1]) == b"".join(blocks)


@pytest.mark.parametrize("total", [65, 1 << 31])
def test_announced_sizes_above_the_limit_are_refused(total: int) -> None:
    head = framing.INDEX + b"\3\1" + b"\xff" * 8 + struct.pack("<3I", total // 2, total - total // 2 - 1, 1)
    with pytest.raises(WireError, match="announces"):
        framing.body_size(head, 0, 64)


# -- datagrams ---------------------------------------------------------------------------------------------------------


def test_a_recorded_datagram_is_assembled_and_written_again() -> None:
    """The first was captured from mcast of YARP 4.0 (udp's is identical); the second only ends a stream."""
    recorded = bytes.fromhex(
        "e5 18 af 9b 00 00 00 00 59 41 0a 00 00 00 52 50 02 01 ff ff ff ff ff ff ff ff 08 00 00 00 1b 00 00 00"
        "00 00 00 00 00 00 00 00 7e 44 00 01 00 01 00 00 02 00 00 00 04 00 00 00 03 00 00 00 6d 73 67 01 00 00 00"
        "05 00 00 00"
    )
    assembler = Assembler()
    message = assembler.add(recorded)
    assert message == recorded[8:]
    assert list(split([message])) == [recorded]
    assert assembler.add(bytes.fromhex("76 68 8a e3 ff ff ff ff 00 00 00 00 00 00 00 00 00 00")) is None
    assert (assembler.spoiled, assembler.incomplete) == (0, 0)


@pytest.mark.parametrize("size", [0, 1, LARGEST - 38, LARGEST - 37, 3 * LARGEST])
def test_messages_are_split(size: int) -> None:
    payload = bytes(range(256)) * (size // 256) + bytes(size % 256)
    whole = framing.prefix(size) + payload
    parts = list(split([framing.prefix(size), payload[: size // 3], payload[size // 3 :]]))
    assert all(len(p) <= 65507 for p in parts)
    assert [struct.unpack_from("<Ii", p) for p in parts] == [(zlib.crc32(p[8:]), i) for i, p in enumerate(parts)]
    assembler = Assembler()
    assert [assembler.add(p) for p in parts][-1] == whole


@given(st.lists(st.integers(0, 4), max_size=30))
def test_only_messages_with_complete_datagrams_in_order_are_returned(order: list[int]) -> None:
    """Only messages whose datagrams arrived in order are returned, each complete."""
    whole = framing.prefix(200) + bytes(200)
    parts = [datagram(whole[i * 50 : i * 50 + 50], i) for i in range(5)]
    assembler = Assembler()
    messages = [assembler.add(parts[i]) for i in order]
    in_order = sum(order[i : i + 5] == [0, 1, 2, 3, 4] for i in range(len(order)))
    assert [f for f in messages if f is not None] == [whole] * in_order


def test_memory_of_datagrams_is_bounded() -> None:
    assembler = Assembler(1000)
    head = framing.INDEX + b"\2\1" + b"\xff" * 8 + struct.pack("<3i", 8, 2000, 0)
    with pytest.raises(WireError, match="announces"):
        assembler.add(datagram(head, 0))
    for number in range(1, 50):
        assert assembler.add(datagram(bytes(60000), number)) is None
    assert len(assembler._received) == 0

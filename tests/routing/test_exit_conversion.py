"""The exit converts and checks messages from the hub exactly as the route's conversion does, or refuses them."""

from __future__ import annotations

import math
import random
import struct
import sys
from collections.abc import Callable
from typing import Any

import pytest

from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import native_program
from bridge.routing.counters import Counters
from bridge.routing.doorway import Deadline
from bridge.routing.exit import Exit
from tests.peers.native import GID, RecordingOutput, pass_on

REGISTRY = Registry()
JOINTS, BATTERY, IMAGE = "sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/Image"
TO_ROS1 = {name: REGISTRY.hub_to_ros1(name).convert for name in (JOINTS, BATTERY)}
CHECK = {name: REGISTRY.hub_check(name) for name in (BATTERY, "std_msgs/msg/Bool")}
LARGEST = 64 * 1024

Convert = Callable[[bytes], bytes]


class Converting:
    """An exit with a conversion."""

    def __init__(self, convert: Convert | None, limit: int = LARGEST) -> None:
        assert convert is not None
        self.output, lease = RecordingOutput(), Deadline()
        lease.until = math.inf
        self.exit = Exit(lease, None, (), (), native_program(convert), limit, ())
        self.exit.allow({GID})
        self.exit.send_by(self.output)

    def result(self, payload: bytes) -> bytes | None:
        """Return the message that the exit sends; None if it refuses the message."""
        sent = pass_on(self.exit, payload)
        assert len(self.output.sent) == sent
        return self.output.sent.pop() if sent else None


def expected(convert: Convert, payload: bytes) -> bytes | None:
    try:
        return convert(payload)
    except ConversionError:
        return None


def joints(draw: random.Random) -> bytes:
    """Return a JointState as CDR."""
    numbers = {
        field: [draw.gauss(0, 1) for _ in range(draw.randrange(20))] for field in ("position", "velocity", "effort")
    }
    names = ["n" * draw.randrange(12) for _ in range(draw.randrange(20))]
    header = {"stamp": {"sec": draw.getrandbits(30)}, "frame_id": "f" * draw.randrange(9)}
    return from_json(REGISTRY, JOINTS, {"header": header, "name": names, **numbers})


def battery(draw: random.Random) -> bytes:
    """Return a BatteryState as CDR."""
    values: dict[str, Any] = {
        "header": {"frame_id": "x" * draw.randrange(9)},
        "voltage": draw.random(),
        "present": draw.random() < 0.5,
        "cell_voltage": [draw.random() for _ in range(draw.randrange(9))],
        "location": "y" * draw.randrange(9),
    }
    return from_json(REGISTRY, BATTERY, values)


def damaged(draw: random.Random, message: bytes) -> bytes:
    """Return a message with another byte, without its end, or with more bytes."""
    at = draw.randrange(len(message))
    change = draw.randrange(3)
    if change == 0:
        return message[:at] + bytes([draw.choice((0, 1, 2, 255))]) + message[at + 1 :]
    return message[:at] if change == 1 else message + bytes(draw.randrange(12))


MAKERS: dict[str, Callable[[random.Random], bytes]] = {JOINTS: joints, BATTERY: battery}


@pytest.mark.parametrize("name", MAKERS)
def test_a_converted_message_is_that_of_the_conversion(name: str) -> None:
    converting, convert, draw = Converting(TO_ROS1[name]), TO_ROS1[name], random.Random(1)
    size = 0
    for _ in range(500):
        message = MAKERS[name](draw)
        result = converting.result(message)
        assert result == convert(message) != message
        size += len(result)
    assert (converting.exit.messages, converting.exit.bytes) == (500, size), "the bytes are those that are sent"


@pytest.mark.parametrize("name", MAKERS)
def test_a_message_that_cannot_be_converted_is_refused(name: str) -> None:
    converting, draw, refused = Converting(TO_ROS1[name]), random.Random(2), 0
    for _ in range(1000):
        message = damaged(draw, MAKERS[name](draw))
        result = converting.result(message)
        assert result == expected(TO_ROS1[name], message)
        refused += result is None
    assert 100 < refused < 1000, "some messages are invalid"
    assert converting.exit.messages == 1000 - refused, "only those that were sent are counted"


@pytest.mark.parametrize("convert", [TO_ROS1[JOINTS], CHECK[BATTERY]], ids=["conversion", "check"])
@pytest.mark.parametrize("message", [b"", b"\0", b"\0\1\0\0", bytes(3), b"\xff" * 64])
def test_bytes_that_are_no_message_are_refused(convert: Convert, message: bytes) -> None:
    converting = Converting(convert)
    assert converting.result(message) is None
    assert converting.exit.bytes == 0


def test_a_message_of_another_byte_order_is_refused() -> None:
    message = battery(random.Random(3))
    for convert in (TO_ROS1[BATTERY], CHECK[BATTERY]):
        converting = Converting(convert)
        assert converting.result(message) == convert(message)
        assert converting.result(b"\0\0" + message[2:]) is None


def test_the_converted_size_is_limited() -> None:
    message = joints(random.Random(4))
    convert = TO_ROS1[JOINTS]
    size = len(convert(message))
    assert size < len(message)
    assert Converting(convert, size).result(message) == convert(message)
    assert Converting(convert, size - 1).result(message) is None


def test_a_message_that_grows_beyond_the_largest_one_is_refused() -> None:
    """ROS 1 has a number in the header that the hub lacks; CDR has 4 bytes in front and padding."""
    convert = REGISTRY.hub_to_ros1("std_msgs/msg/Header").convert
    assert convert is not None
    grown = LARGEST + 4

    def header(size: int) -> bytes:
        return struct.pack("<HHiII", 0x100, 0, 1, 2, size + 1) + b"x" * size + b"\0"

    fits = next(size for size in range(LARGEST, 0, -1) if len(convert(header(size))) <= LARGEST)
    assert len(convert(header(fits))) == LARGEST
    converting = Converting(convert, grown)
    assert converting.result(header(fits)) == convert(header(fits))
    assert converting.result(header(fits + 1)) is None


def test_a_checked_message_is_sent_in_its_normal_form() -> None:
    checking, convert, draw = Converting(CHECK[BATTERY]), CHECK[BATTERY], random.Random(5)
    results = {True: 0, False: 0, None: 0}
    for _ in range(1500):
        message = damaged(draw, battery(draw)) if draw.random() < 0.7 else battery(draw)
        result = checking.result(message)
        assert result == expected(convert, message)
        results[None if result is None else result == message] += 1
    assert min(results.values()) > 50, "unchanged, changed and invalid messages"


@pytest.mark.parametrize(("value", "normal"), [(0, 0), (1, 1), (2, 1), (255, 1)])
@pytest.mark.parametrize("slack", range(8))
def test_a_bool_is_normalized_and_slack_is_removed(value: int, normal: int, slack: int) -> None:
    checking = Converting(CHECK["std_msgs/msg/Bool"])
    assert checking.result(b"\0\1\0\0" + bytes([value]) + bytes(slack)) == b"\0\1\0\0" + bytes([normal])
    assert checking.result(b"\0\1\0\0" + bytes([value]) + bytes(8)) is None, "more than the slack of a serializer"
    assert checking.exit.bytes == 5


def test_converted_messages_are_counted_by_the_route() -> None:
    converting, counters, draw = Converting(TO_ROS1[JOINTS]), Counters(), random.Random(6)
    counters.exit = converting.exit
    messages = [joints(draw) for _ in range(20)]
    converted = [converting.result(message) for message in messages]
    assert counters.messages == 20
    assert converting.exit.bytes == sum(len(message or b"") for message in converted)


def test_the_program_lives_as_long_as_the_exit() -> None:
    program = native_program(TO_ROS1[JOINTS] or bytes)
    before = sys.getrefcount(program)
    way = Exit(Deadline(), None, (), (), program, LARGEST, ())
    assert sys.getrefcount(program) == before + 1
    del way
    assert sys.getrefcount(program) == before


def test_conversions_do_not_leak() -> None:
    converting, draw = Converting(TO_ROS1[JOINTS]), random.Random(8)
    messages = [damaged(draw, joints(draw)) if n % 3 == 0 else joints(draw) for n in range(50)]
    counts = []
    for _ in range(2):
        for _ in range(100):
            for message in messages:
                converting.result(message)
        counts.append(sys.getallocatedblocks())
    assert counts[1] - counts[0] < 500
    assert converting.exit.messages > 5000

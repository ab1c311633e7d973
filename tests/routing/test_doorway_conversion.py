"""The doorway converts and checks messages exactly as the route's conversion does, and leaves invalid ones to it."""

from __future__ import annotations

import math
import random
import struct
from collections import deque
from collections.abc import Callable, Iterator

import pytest

from bridge.hub.lane.joining import MAX_JOINED_BYTES
from bridge.hub.lane.links import Epoch, Sender
from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import native_program
from bridge.routing.counters import CARRY_BOUNDS
from bridge.routing.doorway import Deadline, Doorway
from tests.peers.hub.lane import RecordedLane

REGISTRY = Registry()
TO_HUB = REGISTRY.ros1_to_hub("sensor_msgs/JointState").convert
BATTERY = "sensor_msgs/msg/BatteryState"
CHECK = REGISTRY.hub_check(BATTERY)
CHECK_BOOL = REGISTRY.hub_check("std_msgs/msg/Bool")
GID = bytes(16)
assert TO_HUB is not None


class Converting(RecordedLane):
    """A doorway with a conversion, and the messages that it leaves to the route."""

    def __init__(self, convert: Callable[[bytes], bytes], limit: int = MAX_JOINED_BYTES) -> None:
        super().__init__()
        sender, lease, self.left = Sender(GID, Epoch()), Deadline(), list[bytes]()
        sender.send_to(((self.link, 1),))
        sender.rest(0, 0)
        sender.direct, lease.until = True, math.inf
        conditions = (lease, None, deque[object]())
        program = native_program(convert)
        self.doorway = Doorway(lambda payload, *_: self.left.append(payload), *conditions, program, limit, CARRY_BOUNDS)
        self.doorway.admit("a", sender)

    def result(self, payload: bytes) -> bytes | None:
        """Return the message that the doorway sends; None if it leaves the message to the route."""
        self.doorway(payload, "a", None)
        sent = [message.payload for message in self.messages()]
        if sent:
            assert self.left == []
            return sent.pop()
        assert self.left == [payload]
        self.left.clear()
        return None


@pytest.fixture
def to_hub() -> Iterator[Converting]:
    converting = Converting(TO_HUB)
    yield converting
    converting.close()


@pytest.fixture
def checking() -> Iterator[Converting]:
    converting = Converting(CHECK)
    yield converting
    converting.close()


def expected(convert: Callable[[bytes], bytes], payload: bytes) -> bytes | None:
    try:
        return convert(payload)
    except ConversionError:
        return None


def joints(draw: random.Random, most: int = 20) -> bytes:
    """Return a JointState in ROS 1's serialization."""

    def text() -> bytes:
        characters = draw.randbytes(draw.randrange(12))
        return struct.pack("<I", len(characters)) + characters

    def numbers() -> bytes:
        values = [draw.gauss(0, 1) for _ in range(draw.randrange(most))]
        return struct.pack(f"<I{len(values)}d", len(values), *values)

    names = [text() for _ in range(draw.randrange(most))]
    head = struct.pack("<III", draw.getrandbits(32), draw.getrandbits(32), draw.getrandbits(32)) + text()
    return head + struct.pack("<I", len(names)) + b"".join(names) + numbers() + numbers() + numbers()


def battery(draw: random.Random) -> bytes:
    """Return a BatteryState as CDR."""
    return from_json(
        REGISTRY,
        BATTERY,
        {
            "header": {"frame_id": "x" * draw.randrange(9)},
            "voltage": draw.random(),
            "present": draw.random() < 0.5,
            "cell_voltage": [draw.random() for _ in range(draw.randrange(9))],
            "location": "y" * draw.randrange(9),
        },
    )


def damaged(draw: random.Random, message: bytes) -> bytes:
    """Return a message with another byte, without its end, or with more bytes."""
    at = draw.randrange(len(message))
    change = draw.randrange(3)
    if change == 0:
        return message[:at] + bytes([draw.choice((0, 1, 2, 255))]) + message[at + 1 :]
    return message[:at] if change == 1 else message + bytes(draw.randrange(12))


def test_a_converted_message_is_that_of_the_conversion(to_hub: Converting) -> None:
    draw = random.Random(1)
    for _ in range(500):
        message = joints(draw)
        assert to_hub.result(message) == TO_HUB(message)
    assert to_hub.doorway.messages == 500


def test_the_bytes_of_converted_messages_are_counted(to_hub: Converting) -> None:
    message = joints(random.Random(2))
    to_hub.result(message)
    assert to_hub.doorway.bytes == len(TO_HUB(message)) != len(message)


def test_a_message_that_cannot_be_converted_is_left_to_the_route(to_hub: Converting) -> None:
    draw, left = random.Random(3), 0
    for _ in range(1000):
        message = damaged(draw, joints(draw))
        result = to_hub.result(message)
        assert result == expected(TO_HUB, message)
        left += result is None
    assert 100 < left < 1000, "some messages are invalid"
    assert to_hub.doorway.messages == 1000 - left, "only those that were sent are counted"


@pytest.mark.parametrize("message", [b"", b"\0", bytes(3), b"\xff" * 64])
def test_bytes_that_are_no_message_are_left_to_the_route(
    to_hub: Converting, checking: Converting, message: bytes
) -> None:
    assert to_hub.result(message) is None
    assert checking.result(message) is None


def test_the_converted_size_is_limited() -> None:
    message = joints(random.Random(4))
    size = len(TO_HUB(message))
    assert size > len(message)
    for limit, result in ((size, TO_HUB(message)), (size - 1, None), (len(message), None)):
        converting = Converting(TO_HUB, limit)
        assert converting.result(message) == result
        converting.close()


def test_a_message_that_grows_beyond_the_largest_joined_one_is_left_to_the_route(to_hub: Converting) -> None:
    """Conversion adds 4 bytes and the padding of the doubles."""
    head = struct.pack("<IIIII", 0, 0, 0, 0, 0)
    count = (MAX_JOINED_BYTES - len(head) - 12) // 8
    message = head + struct.pack("<I", count) + bytes(8 * count) + bytes(8)
    assert len(message) <= MAX_JOINED_BYTES < len(TO_HUB(message))
    assert to_hub.result(message) is None
    message = head + struct.pack("<I", count - 2) + bytes(8 * (count - 2)) + bytes(8)
    assert to_hub.result(message) == TO_HUB(message)


def test_a_checked_message_is_sent_in_its_normal_form(checking: Converting) -> None:
    draw, results = random.Random(5), {True: 0, False: 0, None: 0}
    for _ in range(1500):
        message = damaged(draw, battery(draw)) if draw.random() < 0.7 else battery(draw)
        result = checking.result(message)
        assert result == expected(CHECK, message)
        results[None if result is None else result == message] += 1
    assert min(results.values()) > 50, "unchanged, changed and invalid messages"


@pytest.mark.parametrize(("value", "normal"), [(0, 0), (1, 1), (2, 1), (255, 1)])
@pytest.mark.parametrize("slack", range(8))
def test_a_bool_is_normalized_and_slack_is_removed(value: int, normal: int, slack: int) -> None:
    checking = Converting(CHECK_BOOL)
    assert checking.result(b"\0\1\0\0" + bytes([value]) + bytes(slack)) == b"\0\1\0\0" + bytes([normal])
    assert checking.result(b"\0\1\0\0" + bytes([value]) + bytes(8)) is None, "more than the slack of a serializer"
    assert checking.doorway.bytes == 5
    checking.close()


def test_a_message_that_is_too_large_only_with_its_slack_is_left_to_the_route() -> None:
    checking, message = Converting(CHECK_BOOL, limit=6), b"\0\1\0\0\1"
    assert checking.result(message + bytes(1)) == message
    assert checking.result(message + bytes(2)) is None
    checking.close()


def test_a_message_of_another_byte_order_is_left_to_the_route(checking: Converting) -> None:
    message = battery(random.Random(6))
    assert checking.result(message) == message
    assert checking.result(b"\0\0" + message[2:]) is None


def test_only_conversions_of_the_virtual_machine_have_a_program() -> None:
    assert native_program(lambda payload: payload) is None
    assert native_program(b"x".join) is None  # type: ignore[arg-type]
    for convert, checks in ((TO_HUB, False), (CHECK, True)):
        program = native_program(convert)
        assert program is not None
        assert program[0] is checks


def test_a_doorway_refuses_an_incomplete_program() -> None:
    program = native_program(CHECK)
    assert program is not None
    for other in (program[:-1], (*program[:-1], "text")):
        with pytest.raises(TypeError):
            Doorway(print, Deadline(), None, deque(), other, 10, ())  # type: ignore[arg-type]

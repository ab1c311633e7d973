"""The velocity at the end of a message, in any serialization."""

from __future__ import annotations

import struct

import pytest

from bridge.messages.velocities import TWIST, TWIST_STAMPED, is_zero, stop_after

CDR, STAMP = b"\0\1\0\0", bytes(8) + b"\5\0\0\0base\0" + bytes(7)


@pytest.mark.parametrize(
    ("type_name", "head"),
    [(TWIST, CDR), (TWIST_STAMPED, CDR + STAMP), ("geometry_msgs/Twist", b""), ("geometry_msgs/TwistStamped", STAMP)],
)
def test_zero_is_recognized(type_name: str, head: bytes) -> None:
    for number in range(6):
        velocity = [0.0] * 6
        for value, zero in ((-0.0, True), (1e-9, False), (-1.0, False), (float("nan"), False)):
            velocity[number] = value
            assert is_zero(type_name, head + struct.pack("<6d", *velocity)) is zero
    assert is_zero(type_name, stop_after(type_name, head + struct.pack("<6d", *range(6))))


@pytest.mark.parametrize(
    ("type_name", "payload"), [(TWIST, CDR + bytes(40)), (TWIST, b""), ("std_msgs/msg/Float64", CDR + bytes(48))]
)
def test_other_messages_are_not_zero(type_name: str, payload: bytes) -> None:
    assert not is_zero(type_name, payload)

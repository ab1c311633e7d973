"""Conversions between buffers give the same messages and errors as the route's conversion, with and without C."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest

from bridge.messages import buffers, copies
from bridge.messages.copies import copied, copy_to
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.transcode import direct
from bridge.messages.transcode.conversion import make_vm, native_program
from bridge.messages.transcode.direct import DirectConversion
from tests.messages.transcode.programs import TYPES, damaged, programs

ROUNDS = 100


@pytest.fixture(params=["in C", "without a compiler"])
def compiled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    if request.param != "in C":
        for module in (copies, direct):
            monkeypatch.setattr(module, "buffers", None)
    return bool(request.param == "in C")


def outcome(convert: Callable[[Any], bytes | memoryview], message: bytes | memoryview) -> bytes | str:
    try:
        return bytes(convert(message))
    except ConversionError as err:
        return str(err)


def written(conversion: DirectConversion, message: bytes, *, compiled: bool) -> bytes:
    """Return the converted message, as it is written to a place between other bytes."""
    place = bytearray(b"x" * (4 * len(message) + 4096))
    sizes: list[int] = []

    def room(size: int) -> memoryview:
        sizes.append(size)
        return memoryview(place)[8 : 8 + size]

    converted = conversion.write(message, room)
    if converted is not None:
        assert not compiled
        return converted
    (size,) = sizes
    assert set(place[:8] + place[8 + size :]) == {ord("x")}
    return bytes(place[8 : 8 + size])


@pytest.mark.parametrize("name", TYPES)
def test_messages_are_converted_between_buffers(name: str, registry: Registry, *, compiled: bool) -> None:
    dice = random.Random(7)
    accepted = refused = 0
    for program, good in programs(registry, name):
        machine = make_vm(program)
        convert = machine.check if program.source_cdr and program.target_cdr else machine.convert
        conversion = DirectConversion(convert)
        for _ in range(ROUNDS):
            message = damaged(good, dice)
            expected = outcome(convert, message)
            assert outcome(conversion.read, memoryview(bytearray(message))) == expected
            assert outcome(lambda m: written(conversion, m, compiled=compiled), message) == expected  # noqa: B023 - called at once
            accepted += isinstance(expected, bytes)
            refused += isinstance(expected, str)
    assert accepted > 10
    assert refused > 10


@pytest.mark.parametrize("convert", [None, bytes.upper], ids=["unchanged", "by Python"])
def test_a_conversion_may_need_python_or_nothing(convert: Callable[[bytes], bytes] | None, *, compiled: bool) -> None:
    conversion, expected = DirectConversion(convert), b"A" if convert else b"a"
    assert bytes(conversion.read(memoryview(b"a"))) == expected
    assert written(conversion, b"a", compiled=compiled and convert is None) == expected


@pytest.mark.usefixtures("compiled")
def test_without_room_the_converted_message_is_returned(registry: Registry) -> None:
    ((check, cdr), (to_ros1, _), _) = programs(registry, "std_msgs/msg/Bool")
    for convert in (make_vm(check).check, make_vm(to_ros1).convert, None):
        assert DirectConversion(convert).write(cdr, lambda _: None) == (cdr if convert is None else convert(cdr))


def test_an_unchanged_message_is_read_without_a_copy(registry: Registry) -> None:
    ((check, cdr), *_) = programs(registry, "std_msgs/msg/Bool")
    memory = bytearray(cdr + b"\0\0\0")  # three bytes of slack
    for convert, size in ((None, len(memory)), (make_vm(check).check, len(cdr))):
        view = DirectConversion(convert).read(memoryview(memory))
        assert isinstance(view, memoryview)
        memory[0] ^= 255
        assert bytes(view) == bytes(memory[:size])
        memory[0] ^= 255


@pytest.mark.usefixtures("compiled")
def test_a_message_is_copied_to_a_place() -> None:
    memory = bytearray(b"xxxxxxxxx")
    copy_to(b"message", memoryview(memory)[1:8])
    assert memory == b"xmessagex"


@pytest.mark.usefixtures("compiled")
def test_a_copy_does_not_change_with_the_buffer() -> None:
    memory = bytearray(b"before")
    copy = copied(memoryview(memory))
    memory[:] = b"after!"
    assert copy == b"before"


def test_sizes_beyond_a_buffer_are_refused(registry: Registry) -> None:
    (_, (to_ros1, cdr), _) = programs(registry, "std_msgs/msg/Bool")
    native = native_program(make_vm(to_ros1).convert)
    size, copies = buffers.measured(native, cdr) or (0, True)
    assert (size, copies) == (1, False)
    with pytest.raises(ValueError, match="a place of 0 bytes has no room for 1"):
        buffers.write_to(native, cdr, size, copies, bytearray())
    for program, claims in ((None, False), (None, True), (native, True)):
        for number in (len(cdr) + 1, -1):
            with pytest.raises(ValueError, match=f"cannot have {number}"):
                buffers.write_to(program, cdr, number, claims, bytearray(100))
            with pytest.raises(ValueError, match=f"cannot have {number}"):
                buffers.converted(program, cdr, number, claims)
    with pytest.raises(TypeError, match="read-write"):
        buffers.write_to(None, cdr, 1, True, cdr)


@pytest.mark.parametrize("name", TYPES)
def test_a_message_that_changes_after_it_was_measured_stays_within_its_place(name: str, registry: Registry) -> None:
    """The memory of a message may be shared with another process, which may write to it at any time."""
    dice = random.Random(7)
    refused = 0
    for program, good in programs(registry, name):
        machine = make_vm(program)
        native = native_program(machine.check if program.source_cdr and program.target_cdr else machine.convert)
        for _ in range(ROUNDS):
            measured, changed = buffers.measured(native, damaged(good, dice)), damaged(good, dice)
            if measured is None:
                continue
            place = bytearray(b"x" * (4 * len(good) + 8192))
            try:
                buffers.write_to(native, changed, *measured, memoryview(place)[8:])
            except ValueError:
                refused += 1
            assert set(place[:8] + place[8 + measured[0] :]) == {ord("x")}
    assert refused > 10


def test_a_message_that_changes_after_it_was_measured_is_refused(registry: Registry) -> None:
    (_, (to_ros1, cdr), _) = programs(registry, "std_msgs/msg/Bool")
    native = native_program(make_vm(to_ros1).convert)
    measured = buffers.measured(native, cdr)
    assert measured is not None
    for changed in (b"", cdr + bytes(8)):
        with pytest.raises(ValueError, match="the message changed while it was converted"):
            buffers.converted(native, changed, *measured)
        with pytest.raises(ValueError, match="the message changed while it was converted"):
            buffers.write_to(native, changed, *measured, bytearray(100))

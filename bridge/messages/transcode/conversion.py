"""Conversions: a message or service type as each side announces it, and the converters of its bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from bridge.messages.definitions.schema import Schema, World
from bridge.messages.errors import ConversionError
from bridge.messages.mapping.fields import PairTable
from bridge.messages.transcode.compiler import compile_check, compile_pair
from bridge.messages.transcode.opcodes import FAULT_BITS, INSTRUCTION_BITS, MAX_MESSAGE, MessageFault
from bridge.messages.transcode.program import ConversionProgram
from bridge.messages.transcode.vm import VirtualMachine


@dataclass(frozen=True, slots=True)
class SideType:
    """A message or service type as one side announces it."""

    name: str  #: as the side spells it
    type_id: str  #: md5 sum on ROS 1, RIHS01 hash (``RIHS01_<64 hex>``) on ROS 2 and the hub
    # full text: the type's own definition, then each nested type's after a line of ``=`` and one of ``MSG: name``
    definition: str


@dataclass(frozen=True, slots=True)
class Conversion:
    """The conversion of one type from one wire format to another; ``convert`` is None if the bytes are the same.

    ``convert(payload: bytes) -> bytes`` raises `bridge.messages.errors.ConversionError` for an invalid message.
    ``left_out`` names the fields of a ROS 1 message that are lost, because the target lacks them.
    """

    source: SideType
    target: SideType
    convert: Callable[[bytes], bytes] | None
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ServiceConversion:
    """The conversions of a service's requests and replies, the same for calls in both directions.

    Each is ``convert(payload: bytes) -> bytes`` and raises `bridge.messages.errors.ConversionError`; None if the bytes
    are the same.
    """

    side: SideType  #: the service type on the side (ROS 1: ``std_srvs/SetBool`` and md5)
    # the service type in ROS 2 (``std_srvs/srv/SetBool`` and the service's RIHS01). The definition of either type is
    # the request's full text, a line ``---``, and the response's full text.
    hub: SideType
    request_to_side: Callable[[bytes], bytes] | None
    request_to_hub: Callable[[bytes], bytes] | None
    response_to_side: Callable[[bytes], bytes] | None
    response_to_hub: Callable[[bytes], bytes] | None
    # the fields of ROS 1's request and response that are lost, because the hub's types lack them
    left_out: tuple[str, ...] = ()


Convert = Callable[[bytes], bytes]
"""Converts one message's bytes to the other wire format; raises `ConversionError`."""

_REASONS = {
    MessageFault.TRUNCATED: "the message ends before the field does, or its length is wrong",
    MessageFault.TOO_MANY: "more elements than its type allows",
    MessageFault.TOO_LONG: "the string is longer than its type allows",
    MessageFault.NO_NUL: "the string has no closing NUL",
    MessageFault.TRAILING: "bytes are left over after the last field",
    MessageFault.ENCAPSULATION: "not little-endian CDR: the message does not begin with 00 01",
    MessageFault.TOO_LARGE: f"the converted message would be larger than {MAX_MESSAGE} bytes",
    MessageFault.ENDLESS: "more elements without content than a message may have",
}


def ros1_to_cdr(source: Schema, target: Schema, pairs: PairTable) -> Convert:
    """Return the converter of a ROS 1 type's bytes to CDR."""
    return make_vm(compile_pair(source, target, lambda ros1, ros2: pairs[ros1, ros2].fields)).convert


def cdr_to_ros1(source: Schema, target: Schema, pairs: PairTable) -> Convert:
    """Return the converter of CDR to a ROS 1 type's bytes."""
    return make_vm(
        compile_pair(source, target, lambda ros2, ros1: [(path2, path1) for path1, path2 in pairs[ros1, ros2].fields])
    ).convert


def check_cdr(schema: Schema) -> Convert:
    """Return a function that checks CDR against its type and returns the normal form (the same object if unchanged)."""
    assert schema.world is World.ROS2
    return make_vm(compile_check(schema)).check


def make_vm(program: ConversionProgram) -> VirtualMachine:
    """Return the virtual machine of a program, with readable errors for invalid messages."""
    return VirtualMachine(*program.assemble(), partial(_error, program))


def native_program(convert: Convert) -> tuple[bool, int, int, bytes, bytes] | None:
    """Return what C code needs for a conversion: whether it only checks, and `VirtualMachine.program`.

    None: the conversion needs Python.
    """
    machine = getattr(convert, "__self__", None)
    program = machine.program if isinstance(machine, VirtualMachine) else None
    return None if program is None else (convert == machine.check, *program)  # type: ignore[union-attr]  # not None


def _error(program: ConversionProgram, fault: int) -> ConversionError:
    number = (-fault >> FAULT_BITS) & ((1 << INSTRUCTION_BITS) - 1)
    byte = -fault >> (FAULT_BITS + INSTRUCTION_BITS)
    reason = MessageFault(-fault & ((1 << FAULT_BITS) - 1))
    field = program.field_of(number)
    where = f"field {field}, byte {byte}" if field and reason is not MessageFault.ENCAPSULATION else f"byte {byte}"
    return ConversionError(f"bad {program.name} message: {_REASONS[reason]} ({where})")

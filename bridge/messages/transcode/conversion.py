"""Conversions: a message type as each side names it, and the converters of its bytes."""

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
    """A message type as one side names it."""

    name: str  #: as the side spells it
    type_id: str  #: md5 sum on ROS 1, RIHS01 hash (``RIHS01_<64 hex>``) on ROS 2 and the hub
    # full text: the type's own definition, then each nested type's after a line of ``=`` and one of ``MSG: name``
    definition: str


@dataclass(frozen=True, slots=True)
class Conversion:
    """How one type's bytes get from one wire to another; ``convert`` is None where the bytes are the same.

    ``convert(payload: bytes) -> bytes`` raises `bridge.messages.errors.ConversionError` for a bad message.
    ``left_out`` names the fields of a ROS 1 message that get lost, because the target has none for them.
    """

    source: SideType
    target: SideType
    convert: Callable[[bytes], bytes] | None
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ServiceConversion:
    """How a service's requests and replies get from one wire to another; the same for calls in both directions.

    Each is ``convert(payload: bytes) -> bytes`` and raises `bridge.messages.errors.ConversionError`; None where the
    bytes are the same.
    """

    side: SideType  #: the service type as the side names it (ROS 1: ``std_srvs/SetBool`` and md5)
    # as ROS 2 names it (``std_srvs/srv/SetBool`` and the service's RIHS01). The definition of either is the request's
    # full text, a line ``---``, and the response's.
    hub: SideType
    request_to_side: Callable[[bytes], bytes] | None
    request_to_hub: Callable[[bytes], bytes] | None
    response_to_side: Callable[[bytes], bytes] | None
    response_to_hub: Callable[[bytes], bytes] | None
    # the fields of ROS 1's request and response that get lost, because the hub's have none for them
    left_out: tuple[str, ...] = ()


Convert = Callable[[bytes], bytes]
"""Takes one message's bytes and gives its bytes on the other wire; raises `ConversionError`."""

_REASONS = {
    MessageFault.TRUNCATED: "the message ends before the field does, or its length is wrong",
    MessageFault.TOO_MANY: "more elements than its type allows",
    MessageFault.TOO_LONG: "the string is longer than its type allows",
    MessageFault.NO_NUL: "the string has no closing NUL",
    MessageFault.TRAILING: "bytes are left over behind the last field",
    MessageFault.ENCAPSULATION: "no little-endian CDR: the message does not begin with 00 01",
    MessageFault.TOO_LARGE: f"the converted message would be larger than {MAX_MESSAGE} bytes",
    MessageFault.ENDLESS: "more empty elements than any message holds",
}


def ros1_to_cdr(source: Schema, target: Schema, pairs: PairTable) -> Convert:
    """The converter of a ROS 1 type's bytes to CDR."""
    return make_vm(compile_pair(source, target, lambda one, two: pairs[one, two].fields)).convert


def cdr_to_ros1(source: Schema, target: Schema, pairs: PairTable) -> Convert:
    """The converter of CDR bytes to a ROS 1 type's."""
    return make_vm(
        compile_pair(source, target, lambda one, two: [(path2, path1) for path1, path2 in pairs[two, one].fields])
    ).convert


def check_cdr(schema: Schema) -> Convert:
    """The check of CDR bytes against their type; the same bytes come back where nothing is to be mended."""
    assert schema.world is World.ROS2
    return make_vm(compile_check(schema)).check


def make_vm(program: ConversionProgram) -> VirtualMachine:
    """A program made ready, which refuses bad messages in words."""
    return VirtualMachine(*program.assemble(), partial(_error, program))


def _error(program: ConversionProgram, fault: int) -> ConversionError:
    number = (-fault >> FAULT_BITS) & ((1 << INSTRUCTION_BITS) - 1)
    byte = -fault >> (FAULT_BITS + INSTRUCTION_BITS)
    reason = MessageFault(-fault & ((1 << FAULT_BITS) - 1))
    field = program.field_of(number)
    where = f"field {field}, byte {byte}" if field and reason is not MessageFault.ENCAPSULATION else f"byte {byte}"
    return ConversionError(f"bad {program.name} message: {_REASONS[reason]} ({where})")

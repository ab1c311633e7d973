"""How clients of YARP's releases read a reply: the bytes that their generated code consumes, and the outcome.

From the sources of v3.6.0, v3.9.1, v3.11.2, v3.12.3 and v4.0.0: ``Reply::read`` and ``return_...::read`` of
INavigation2DMsgs, ``WireReader.cpp`` (``readListHeader``, ``readBool``), ``ReturnValue::read``, and afterwards
``AbstractCarrier::defaultExpectAck``, whose result ``Protocol::write`` ignores.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from yarp_compat.dev.service import Call
from yarp_compat.wire.carriers import framed
from yarp_compat.wire.elements import ElementReader
from yarp_compat.wire.errors import Incomplete
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import INT32, LIST, VOCAB32

FAIL, OK = b"fail", b"ok\0\0"
Outcome = tuple[bool, int]
"""Whether the call succeeded, and the offset of the next byte."""


class HangsError(Exception):
    """A client hangs: ``WireReader::fail`` reads until the server closes the connection."""


def word(data: bytes, at: int) -> int:
    """Return the 32-bit integer at an offset."""
    if len(data) < at + 4:
        raise Incomplete("more bytes are expected")
    return int(struct.unpack_from("<i", data, at)[0])


def truth(data: bytes, at: int) -> bool:
    """Read a boolean at an offset as ``readBool`` does."""
    return word(data, at) != 0 and data[at : at + 4] != FAIL


def single_3_6(data: bytes) -> Outcome:
    first = word(data, 0)
    if not first & LIST:
        return False, 4
    word(data, 4)
    if first & ~LIST:
        return truth(data, 8), 12
    if word(data, 8) not in (INT32, VOCAB32):
        raise HangsError
    return truth(data, 12), 16


def first_of_several_3_6(data: bytes, at: int) -> Outcome:
    return (truth(data, at + 4), at + 8) if word(data, at) in (INT32, VOCAB32) else (False, at + 4)


def number_3_11(data: bytes, at: int) -> Outcome:
    word(data, at + 4)
    return word(data, at) == 0, at + 8  # an int64 cast to an enumeration of 32 bits


def number_3_12(data: bytes, at: int) -> Outcome:
    return word(data, at + 4) == 0, at + 8


def nested_4_0(data: bytes, at: int) -> Outcome:
    word(data, at + 12)
    return data[at + 12 : at + 16] == OK, at + 16


@dataclass(frozen=True)
class Release:
    """How the clients of one release read.

    Attributes:
        single: reads an outcome that is the whole reply.
        first: reads an outcome that precedes other results, at an offset.
    """

    name: str
    single: Callable[[bytes], Outcome]
    first: Callable[[bytes, int], Outcome]
    profile: Profile = Profile.YARP3

    def read(self, call: Call, data: bytes, *, acked: bool = True) -> Outcome:
        """Read a reply, and its acknowledgment if it has one; raises `Incomplete` if bytes are missing."""
        ok, end = self.single(data) if call.single else self._several(call, data)
        if not acked:
            return ok, end
        word(data, end + 4)
        more = framed(data, end) or 0
        if len(data) < end + 8 + more:
            raise Incomplete("more bytes are expected")
        return ok, end + 8 + more

    def _several(self, call: Call, data: bytes) -> Outcome:
        assert word(data, 0) == LIST
        if word(data, 4) != len(call.results):
            return False, 8
        ok, end = self.first(data, 8)
        source = ElementReader(data, self.profile, at=end)
        for field in call.results[1:]:
            field.read(source)
        return ok, source.at


RELEASES = (
    Release("3.6", single_3_6, first_of_several_3_6),
    Release("3.9", single_3_6, first_of_several_3_6),
    Release("3.11", lambda data: number_3_11(data, 0), number_3_11),
    Release("3.12", lambda data: number_3_12(data, 0), number_3_12),
    Release("4.0", lambda data: nested_4_0(data, 0), nested_4_0, Profile.YARP4),
)

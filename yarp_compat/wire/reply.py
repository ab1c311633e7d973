"""Detects a Bottle's end in bytes that arrive in pieces: replies have no length, so their structure is parsed.

Each byte is parsed only once, independent of the number of pieces; strings and runs of numbers are skipped.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct

from yarp_compat.wire import tags
from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile

LIMIT = 64 << 20  # maximum bytes of a reply by default
ACKNOWLEDGED = 8  # bytes of the acknowledgment after a reply on tcp: ``YA``, a number, ``RP``

_WORD = Struct("<i").unpack_from
_TWO = Struct("<ii").unpack_from

_SIZES = {profile: tags.sizes(profile) for profile in Profile}
_SIZES3, _SIZES4 = _SIZES[Profile.YARP3], _SIZES[Profile.YARP4]
_SAME_SIZES = {tag: size for tag, size in _SIZES3.items() if _SIZES4.get(tag) == size}


class ReplyReader:
    """A parser that finds the end of one reply of up to ``limit`` bytes, and if possible its profile.

    ``acked``: an acknowledgment follows, which helps to detect the profile.
    """

    def __init__(self, profile: Profile | None = None, *, acked: bool = True, limit: int = LIMIT) -> None:
        self.profile = profile
        self._acked = acked
        self._walks = {known: _Walk(known, limit) for known in ([profile] if profile is not None else Profile)}

    def end(self, data: Buffer) -> int:
        """Return the end of the reply in ``data``; raises `WireError` if invalid or too long, or `Incomplete`."""
        ends: dict[Profile, int] = {}
        missing: Incomplete | None = None
        wrong: WireError | None = None
        for profile, walk in list(self._walks.items()):
            try:
                ends[profile] = walk.end(data)
            except Incomplete as err:
                missing = err
            except WireError as err:
                wrong = err
                del self._walks[profile]
        if not self._walks:
            raise wrong or WireError("the bytes fit no profile")
        if len(self._walks) == 1 and ends:
            return self._decided(*ends.items())
        return self._between(ends, missing, data)

    def _between(self, ends: dict[Profile, int], missing: Incomplete | None, data: Buffer) -> int:
        """Return the end if the bytes fit both profiles."""
        if len(set(ends.values())) == 1 and missing is None:
            return next(iter(ends.values()))
        if not self._acked and Profile.YARP3 in ends:
            return self._decided((Profile.YARP3, ends[Profile.YARP3]))
        for profile, end in ends.items():
            if self._acked and len(data) >= end + ACKNOWLEDGED:
                if _is_acknowledgment(data, end):
                    return self._decided((profile, end))
                del self._walks[profile]
        if not self._walks:
            raise WireError("no acknowledgment follows the reply in either profile")
        raise missing or Incomplete("the acknowledgment after the reply is missing")

    def _decided(self, found: tuple[Profile, int]) -> int:
        self.profile, end = found
        return end


def plain_end(data: Buffer, profile: Profile | None) -> int:
    """Return the end of a Bottle of numbers of one type, from its header; 0 for others, or an ambiguous profile."""
    if len(data) < 8:
        return 0
    tag, count = _TWO(data, 0)
    sizes = _SAME_SIZES if profile is None else _SIZES3 if profile is Profile.YARP3 else _SIZES4
    size = sizes.get(tag - tags.LIST, 0)
    return 8 + count * size if size and count >= 0 else 0


def recognize(data: Buffer) -> Profile | None:
    """Return the only profile that fits all bytes of a Bottle; None if both do. Raises `WireError` if none does."""
    fits: list[Profile] = []
    wrong: WireError | None = None
    for profile in Profile:
        try:
            end = _Walk(profile, len(data)).end(data)
        except WireError as err:
            wrong = wrong or err
            continue
        if end == len(data):
            fits.append(profile)
    if not fits:
        raise wrong or WireError(f"the Bottle is shorter than its {len(data)} bytes")
    return fits[0] if len(fits) == 1 else None


class _Walk:
    """An incremental parser of one Bottle in one profile."""

    def __init__(self, profile: Profile, limit: int) -> None:
        self._sizes = _SIZES[profile]
        self._limit = limit
        self._at = 0
        self._begun = False
        self._left = 0  # elements left in the current list
        self._unit = 0
        self._outer: list[tuple[int, int]] = []

    def end(self, data: Buffer) -> int:
        if not self._begun:
            self._enter(data, 0)
            self._begun = True
        whole = len(data)
        while True:
            while self._left == 0:
                if not self._outer:
                    if self._at > whole:
                        raise Incomplete(f"{self._at - whole} bytes are missing")
                    return self._at
                self._left, self._unit = self._outer.pop()
            if self._unit == 0:
                self._element(data)
            else:
                self._block(data, self._at)

    def _element(self, data: Buffer) -> None:
        """Skip one element with its tag, or enter it if it is a list."""
        at = self._at
        (tag,) = _WORD(data, self._there(data, at, 4))
        size = self._sizes.get(tag)
        if size is not None:
            self._left -= 1
            self._skip(at + 4 + size)
        elif tag in (tags.STRING, tags.BLOB):
            self._block(data, at + 4)
        elif tag & ~tags.UNIT == tags.LIST:
            self._enter(data, at)
        elif tag & ~tags.UNIT == tags.LIST | tags.DICT:
            self._enter(data, at + 4)
        else:
            raise WireError(f"unknown tag {tag} at byte {at}")

    def _block(self, data: Buffer, at: int) -> None:
        """Skip a string or blob, with its length at ``at``."""
        (length,) = _WORD(data, self._there(data, at, 4))
        if length < 0:
            raise WireError(f"the string or blob at byte {at + 4} has a length of {length}")
        self._left -= 1
        self._skip(at + 4 + length)

    def _enter(self, data: Buffer, at: int) -> None:
        """Enter a list after its header; skip its elements if they are numbers."""
        tag, count = _TWO(data, self._there(data, at, 8))
        unit = tag & tags.UNIT
        if tag & ~tags.UNIT != tags.LIST:
            raise WireError(f"{tag:#x} at byte {at} is not the tag of a list")
        if unit and unit not in (tags.STRING, tags.BLOB) and unit not in self._sizes:
            raise WireError(f"unknown type {unit} in a list's tag at byte {at}")
        if len(self._outer) >= tags.MAX_DEPTH:
            raise WireError(f"lists are nested deeper than {tags.MAX_DEPTH} at byte {at}")
        if count < 0:
            raise WireError(f"the list at byte {at} has {count} elements")
        size = self._sizes.get(unit, 0)
        least = size or (5 if unit == 0 else 4)
        if at + 8 + count * least > self._limit:
            raise WireError(f"a list of {count} elements at byte {at} is beyond the limit of {self._limit} bytes")
        if self._begun:
            self._outer.append((self._left - 1, self._unit))
        self._left, self._unit = (0, 0) if size else (count, unit)
        self._skip(at + 8 + count * size)

    def _skip(self, to: int) -> None:
        if to > self._limit:
            raise WireError(f"the Bottle is longer than the limit of {self._limit} bytes")
        self._at = to

    def _there(self, data: Buffer, at: int, size: int) -> int:
        if at + size > len(data):
            raise Incomplete(f"{at + size - len(data)} bytes are missing")
        return at


def _is_acknowledgment(data: Buffer, at: int) -> bool:
    return bytes(data[at : at + 2]) == b"YA" and bytes(data[at + 6 : at + 8]) == b"RP"


ReplyEnd = Callable[[Buffer], int]
"""Returns the end of the reply at the start of the bytes; raises `Incomplete` if bytes are missing."""
_LONG = 1 << 16


class ReplyWatch:
    """Finds a reply's end by ``parse``, or that of a Bottle or line; ``profile`` is the peer's, once it is known."""

    __slots__ = ("_carrier", "_limit", "_next_parse", "_parse", "_reader", "profile")

    def __init__(self, parse: ReplyEnd | None, carrier: Carrier, profile: Profile | None, limit: int) -> None:
        self.profile = profile
        self._carrier = carrier
        self._limit = limit
        self._parse = parse or (_line_end if carrier.text else None)
        self._reader: ReplyReader | None = None
        self._next_parse = 1

    def end(self, data: Buffer) -> int:
        """Return the end of the reply, 0 if it is incomplete; raises `WireError` if it is invalid."""
        if len(data) < self._next_parse:
            return 0
        try:
            if self._parse is not None:
                return self._parse(data)
            end = plain_end(data, self.profile)
            if 0 < end <= len(data):
                return end
            reader = self._reader
            if reader is None:
                reader = self._reader = ReplyReader(self.profile, acked=self._carrier.ack, limit=self._limit)
            end = reader.end(data)
            self.profile = reader.profile
        except Incomplete:
            # a caller's parser restarts each time: a long reply is parsed again only when it has grown by half
            self._next_parse = len(data) + len(data) // 2 if self._parse is not None and len(data) > _LONG else 1
            return 0
        return end

    def pause(self) -> None:
        """Parse again at the next call: no bytes arrived for a while, so the reply may be complete."""
        self._next_parse = 1


def _line_end(data: Buffer) -> int:
    end = bytes(data).find(b"\n")
    if end < 0:
        raise Incomplete("the line is incomplete")
    return end + 1

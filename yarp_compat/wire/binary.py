"""Encodes and decodes Bottles.

A Bottle is ``int32 256 | unit``, ``int32 n``, n elements, little-endian. If all elements have the same type, other than
a list, ``unit`` is their tag and the elements have no tags. (`yarp/os/impl/BottleImpl.cpp`)
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from struct import Struct, unpack_from
from typing import Any

from yarp_compat.wire import tags
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import dict_of
from yarp_compat.wire.values import Float32, Int8, Int16, Int64, Vocab, Vocab64, entries_of, plain, vocab32, vocab64

_TWO = Struct("<ii").pack
_WORD = Struct("<i").pack
_TAG_INT8 = Struct("<ib").pack
_TAG_INT16 = Struct("<ih").pack
_TAG_INT64 = Struct("<iq").pack
_TAG_FLOAT = Struct("<if").pack
_TAG_DOUBLE = Struct("<id").pack

_TRUE = 0x31
_FAMILIES: dict[type, str] = {
    float: "float64", int: "int", Int64: "int", str: "string", bytes: "blob", bool: "vocab", Vocab: "vocab",
    Vocab64: "vocab", Int8: "int8", Int16: "int16", Float32: "float32", list: "list", tuple: "list", dict: "dict",
}  # fmt: skip
"""Families of types that may share one tag. In a list with types of two families, each element has its own tag."""

_ARRAY_TAGS = {"i1": tags.INT8, "u1": tags.INT8, "i2": tags.INT16, "u2": tags.INT16, "i4": tags.INT32,
               "u4": tags.INT32, "i8": tags.INT64, "u8": tags.INT64}  # fmt: skip


Array = Callable[[Buffer, int, int, str], Any]
"""Returns an array of numbers, given the data, the offset, the count and the format character of `struct`."""

_READ_WORD = Struct("<i").unpack_from
_READ_TWO = Struct("<ii").unpack_from
_INT64 = Struct("<q").unpack_from
_FLOAT = Struct("<f").unpack_from
_DOUBLE = Struct("<d").unpack_from

_INT8 = {value: Int8(value) for value in range(-128, 128)}
_KEPT: dict[str, Callable[[Any], Any]] = {"b": _INT8.__getitem__, "h": Int16, "q": Int64, "f": Float32}
"""By format character: the classes of numbers whose size a plain int or float would not preserve."""


class Encoder:
    """An encoder of lists in one profile."""

    def __init__(self, profile: Profile) -> None:
        self._float32 = profile.float32_tag
        self._float64 = profile.float64_tag
        self._vocab64 = profile.vocab64_tag
        self._array_tags = {**_ARRAY_TAGS, "f4": self._float32, "f8": self._float64}
        self._runs: dict[type, tuple[int, str]] = {
            float: (self._float64, "d"), Float32: (self._float32, "f"), Int8: (tags.INT8, "b"),
            Int16: (tags.INT16, "h"), Int64: (tags.INT64, "q"),
        }  # fmt: skip
        self._rare: dict[type, Callable[[Any, list[Buffer], int], None]] = {
            Int8: lambda value, out, _depth: out.append(_TAG_INT8(tags.INT8, value)),
            Int16: lambda value, out, _depth: out.append(_TAG_INT16(tags.INT16, value)),
            Int64: lambda value, out, _depth: out.append(_TAG_INT64(tags.INT64, value)),
            Float32: lambda value, out, _depth: out.append(_TAG_FLOAT(self._float32, value)),
            Vocab: self._number,
            Vocab64: self._number,
            dict: self._dict,
        }

    def bottle(self, values: Any, out: list[Buffer], depth: int = 0) -> None:
        """Append a list as a Bottle, with its header.

        Raises `WireError` like `encode`, but `struct.error` or `OverflowError` for a number that is too large.
        """
        if depth > tags.MAX_DEPTH:
            raise WireError(f"lists are nested deeper than {tags.MAX_DEPTH}")
        if not isinstance(values, (list, tuple)):
            return self._array(values, out, depth)
        kinds = set(map(type, values))
        if len(kinds) == 1:
            (kind,) = kinds
            run = self._runs.get(kind)
            count = len(values)
            if run is not None:
                out.append(struct.pack(f"<ii{count}{run[1]}", tags.LIST | run[0], count, *values))
                return None
            if kind is int:
                try:
                    out.append(struct.pack(f"<ii{count}i", tags.LIST | tags.INT32, count, *values))
                except struct.error:
                    self._family(values, out)
                return None
            if kind in (str, bytes):
                return self._blocks(values, out, kind)
        if any(kind not in _FAMILIES for kind in kinds):
            values = [value if type(value) in _FAMILIES else plain(value) for value in values]
            if any(type(value) not in _FAMILIES for value in values):  # numpy arrays
                return self._mixed(values, out, depth)
            return self.bottle(values, out, depth)
        if {_FAMILIES[kind] for kind in kinds} in ({"int"}, {"vocab"}):
            return self._family(values, out)
        return self._mixed(values, out, depth)

    def _blocks(self, values: Sequence[Any], out: list[Buffer], kind: type) -> None:
        """Append a list of only strings or only blobs."""
        out.append(_TWO(tags.LIST | (tags.STRING if kind is str else tags.BLOB), len(values)))
        for value in values:
            block = _utf8(value) if kind is str else value
            out.append(_WORD(len(block)))
            out.append(block)

    def _family(self, values: Sequence[Any], out: list[Buffer]) -> None:
        """Append a list of ints or vocabs, whose tags depend on the values."""
        pairs = [self._tag_and_body(value) for value in values]
        units = {tag for tag, _ in pairs}
        unit = units.pop() if len(units) == 1 else 0
        out.append(_TWO(tags.LIST | unit, len(values)))
        if unit:
            out.extend(body for _, body in pairs)
        else:
            out.extend(_WORD(tag) + body for tag, body in pairs)

    def _tag_and_body(self, value: Any) -> tuple[int, bytes]:
        if value is True or value is False:
            return tags.VOCAB32, _WORD(_TRUE if value else 0)
        if isinstance(value, Vocab):
            letters = _utf8(value)
            if self._vocab64 is None:
                return tags.VOCAB32, letters[:4].ljust(4, b"\0")
            if len(letters) > 8:
                raise WireError(f"the vocab {value!r} is longer than 8 bytes")
            if len(letters) > 4 or type(value) is Vocab64:
                return self._vocab64, letters.ljust(8, b"\0")
            return tags.VOCAB32, letters.ljust(4, b"\0")
        if type(value) is int and -0x80000000 <= value <= 0x7FFFFFFF:
            return tags.INT32, _WORD(value)
        return tags.INT64, value.to_bytes(8, "little", signed=True)

    def _number(self, value: Any, out: list[Buffer], _depth: int) -> None:
        tag, body = self._tag_and_body(value)
        out.append(_WORD(tag) + body)

    def _mixed(self, values: Sequence[Any], out: list[Buffer], depth: int) -> None:
        """Append a list in which each element has a tag."""
        add = out.append
        float64 = self._float64
        add(_TWO(tags.LIST, len(values)))
        for value in values:
            kind = type(value)
            if kind is float:
                add(_TAG_DOUBLE(float64, value))
            elif kind is int:
                add(_TWO(tags.INT32, value) if -0x80000000 <= value <= 0x7FFFFFFF else _TAG_INT64(tags.INT64, value))
            elif kind is str:
                block = _utf8(value)
                add(_TWO(tags.STRING, len(block)))
                add(block)
            elif kind is list or kind is tuple:
                self.bottle(value, out, depth + 1)
            elif kind is bool:
                add(_TWO(tags.VOCAB32, _TRUE if value else 0))
            elif kind is bytes:
                add(_TWO(tags.BLOB, len(value)))
                add(value)
            elif kind in self._rare:
                self._rare[kind](value, out, depth)
            else:
                self.bottle(value, out, depth + 1)

    def _dict(self, value: dict[Any, Any], out: list[Buffer], depth: int) -> None:
        out.append(_WORD(tags.LIST | tags.DICT))
        self.bottle(entries_of(value), out, depth + 2)

    def _array(self, values: Any, out: list[Buffer], depth: int) -> None:
        """Append a numpy array, without a copy if possible; several dimensions become lists of lists."""
        if not hasattr(values, "dtype"):
            return self.bottle(list(values), out, depth)
        kind = values.dtype.str[1:]
        if values.ndim != 1 or kind not in self._array_tags:
            wider = {"f2": "<f4", "f16": "<f8", "g16": "<f8"}.get(kind)
            return self.bottle(list(values.astype(wider)) if wider else list(values), out, depth)
        out.append(_TWO(tags.LIST | (self._array_tags[kind] if len(values) else 0), len(values)))
        if len(values):
            out.append(block_of(values))
        return None


def block_of(values: Any) -> Buffer:
    """Return the little-endian bytes of a numpy array, without a copy if possible."""
    if values.dtype.str[0] == ">":
        values = values.astype(values.dtype.newbyteorder("<"))
    if not values.flags.c_contiguous:
        return bytes(values.tobytes())
    return memoryview(values).cast("B")


def _utf8(text: str) -> bytes:
    try:
        return text.encode(errors="surrogateescape")
    except UnicodeEncodeError as err:
        raise WireError(f"cannot encode {text!r} as UTF-8: {err.reason}") from None


class Decoder:
    """A decoder of lists in one profile; ``array`` makes the results for lists of numbers of one type (None: lists)."""

    def __init__(self, profile: Profile, array: Array | None = None) -> None:
        self._float32 = profile.float32_tag
        self._float64 = profile.float64_tag
        self._vocab64 = profile.vocab64_tag
        self._formats = tags.formats(profile)
        self._sizes = tags.sizes(profile)
        self._array = array

    def bottle(self, data: Buffer, offset: int) -> tuple[Any, int]:
        """Decode a Bottle; return its values and its end. Raises `WireError`, or `Incomplete` if data is missing."""
        return self._bottle(data, offset, 0)

    def _bottle(self, data: Buffer, offset: int, depth: int) -> tuple[Any, int]:
        if len(data) - offset < 8:
            raise Incomplete(f"a list's header at byte {offset} needs 8 bytes, but {len(data) - offset} are left")
        tag, count = _READ_TWO(data, offset)
        if tag & ~tags.UNIT != tags.LIST:
            raise WireError(f"{tag:#x} at byte {offset} is not the tag of a list")
        return self._list(data, offset + 8, tag & tags.UNIT, count, depth)

    def _list(self, data: Buffer, offset: int, unit: int, count: int, depth: int) -> tuple[Any, int]:
        """Decode the elements of a list; ``unit`` is the tag that all of them share, or 0."""
        if depth > tags.MAX_DEPTH:
            raise WireError(f"lists are nested deeper than {tags.MAX_DEPTH} at byte {offset}")
        if count < 0:
            raise WireError(f"a list before byte {offset} has {count} elements")
        if unit == 0:
            return self._mixed(data, offset, count, depth)
        size = self._sizes.get(unit)
        if size is None:
            if unit in (tags.STRING, tags.BLOB):
                return self._blocks(data, offset, unit, count)
            raise WireError(f"unknown type {unit} in a list's tag before byte {offset}")
        end = offset + count * size
        if end > len(data):
            raise Incomplete(f"a list of {count} elements at byte {offset} needs {end - offset} bytes")
        if unit == tags.VOCAB32:
            return [vocab32(number) for number in unpack_from(f"<{count}i", data, offset)], end
        if unit == self._vocab64:
            return [vocab64(number) for number in unpack_from(f"<{count}q", data, offset)], end
        code = self._formats[unit]
        if self._array is not None:
            return self._array(data, offset, count, code), end
        numbers = unpack_from(f"<{count}{code}", data, offset)
        convert = _KEPT.get(code)
        return list(map(convert, numbers) if convert else numbers), end

    def _blocks(self, data: Buffer, offset: int, unit: int, count: int) -> tuple[list[Any], int]:
        """Decode strings or blobs, each after its length."""
        if len(data) - offset < 4 * count:
            raise Incomplete(f"a list of {count} strings or blobs at byte {offset} needs at least {4 * count} bytes")
        values: list[Any] = []
        whole = len(data)
        for _ in range(count):
            if whole - offset < 4:
                raise Incomplete(f"the length of a string or blob at byte {offset} is missing")
            (length,) = _READ_WORD(data, offset)
            begin = offset + 4
            offset = begin + length
            if length < 0 or offset > whole:
                raise _too_long(length, begin)
            block = data[begin:offset]
            values.append(str(block, "utf-8", "surrogateescape") if unit == tags.STRING else bytes(block))
        return values, offset

    def _mixed(self, data: Buffer, offset: int, count: int, depth: int) -> tuple[list[Any], int]:
        """Decode elements that each have a tag.

        A tag is read together with the next four bytes, which only an int of one or two bytes at the end may lack.
        """
        whole = len(data)
        if whole - offset < 5 * count:
            raise Incomplete(f"a list of {count} elements at byte {offset} needs at least {5 * count} bytes")
        values: list[Any] = []
        add = values.append
        float64 = self._float64
        for _ in range(count):
            if whole - offset < 8:
                value, offset = self._small(data, offset)
                add(value)
                continue
            tag, operand = _READ_TWO(data, offset)
            if tag == float64:
                if whole - offset < 12:
                    raise Incomplete(f"a number at byte {offset} needs 12 bytes")
                add(_DOUBLE(data, offset + 4)[0])
                offset += 12
            elif tag == tags.INT32:
                add(operand)
                offset += 8
            elif tag in (tags.STRING, tags.BLOB):
                begin = offset + 8
                offset = begin + operand
                if operand < 0 or offset > whole:
                    raise _too_long(operand, begin)
                block = data[begin:offset]
                add(str(block, "utf-8", "surrogateescape") if tag == tags.STRING else bytes(block))
            elif tag & ~tags.UNIT == tags.LIST:
                value, offset = self._list(data, offset + 8, tag & tags.UNIT, operand, depth + 1)
                add(value)
            elif tag == tags.VOCAB32:
                add(vocab32(operand))
                offset += 8
            else:
                value, offset = self._rare(data, offset, tag, depth)
                add(value)
        return values, offset

    def _rare(self, data: Buffer, offset: int, tag: int, depth: int) -> tuple[Any, int]:
        """Decode an element of a rarely used type."""
        if tag == self._float32:
            return Float32(_FLOAT(data, offset + 4)[0]), offset + 8
        if tag in (tags.INT64, self._vocab64):
            if len(data) - offset < 12:
                raise Incomplete(f"a number at byte {offset} needs 12 bytes")
            (number,) = _INT64(data, offset + 4)
            return (Int64(number) if tag == tags.INT64 else vocab64(number)), offset + 12
        if tag in (tags.INT8, tags.INT16):
            return self._small(data, offset)
        if tag & ~tags.UNIT == tags.LIST | tags.DICT:
            return self._dict(data, offset + 4, depth + 2)
        raise WireError(f"unknown tag {tag} at byte {offset}")

    def _small(self, data: Buffer, offset: int) -> tuple[int, int]:
        """Decode an int of one or two bytes, which may be at the end of the data."""
        if len(data) - offset < 4:
            raise Incomplete(f"an element's tag at byte {offset} is incomplete")
        (tag,) = _READ_WORD(data, offset)
        body = data[offset + 4 : offset + 6]
        if tag == tags.INT8 and len(body) >= 1:
            return _INT8[body[0] - 256 if body[0] > 127 else body[0]], offset + 5
        if tag == tags.INT16 and len(body) == 2:
            return Int16(int.from_bytes(body, "little", signed=True)), offset + 6
        raise Incomplete(f"the element at byte {offset} with the tag {tag} is incomplete")

    def _dict(self, data: Buffer, offset: int, depth: int) -> tuple[dict[str, Any], int]:
        """Decode a Bottle of lists of a key and its values; other elements are skipped, as in YARP."""
        entries, end = self._bottle(data, offset, depth)
        return dict_of(entries), end


def array(data: Buffer, offset: int, count: int, code: str) -> Any:
    """Return a numpy array as a view of the numbers."""
    import numpy as np

    return np.frombuffer(data, f"<{code}", count, offset) if count else np.empty(0, f"<{code}")


def _too_long(length: int, begin: int) -> WireError:
    if length < 0:
        return WireError(f"the string or blob at byte {begin} has a length of {length}")
    return Incomplete(f"the string or blob of {length} bytes at byte {begin} is incomplete")


_ENCODER3 = Encoder(Profile.YARP3)
_ENCODER4 = Encoder(Profile.YARP4)
_DECODER3 = Decoder(Profile.YARP3)
_DECODER4 = Decoder(Profile.YARP4)
_ARRAYS3 = Decoder(Profile.YARP3, array)
_ARRAYS4 = Decoder(Profile.YARP4, array)


def encode(values: Sequence[Any], profile: Profile) -> bytes:
    """Encode values (of the types in `yarp_compat.wire.values`) as a Bottle; raises `WireError` for other values."""
    return b"".join(encode_parts(values, profile))


def encode_parts(values: Sequence[Any], profile: Profile) -> list[Buffer]:
    """Encode values like `encode`, but return the bytes in pieces, without copying large arrays and blobs."""
    out: list[Buffer] = []
    try:
        (_ENCODER3 if profile is Profile.YARP3 else _ENCODER4).bottle(values, out)
    except (struct.error, OverflowError) as err:
        raise WireError(f"a number is too large for its type: {err}") from None
    return out


def decode(data: Buffer, profile: Profile | None = None) -> list[Any]:
    """Decode a Bottle in a profile (None: the first of YARP 3 and 4 that fits all bytes); raises `WireError`."""
    values: list[Any] = _decoded(data, profile, _DECODER3, _DECODER4)
    return values


def decode_arrays(data: Buffer, profile: Profile | None = None) -> Any:
    """Decode like `decode`, but lists of numbers of one type, even the Bottle itself, become numpy arrays (views)."""
    return _decoded(data, profile, _ARRAYS3, _ARRAYS4)


def decode_prefix(data: Buffer, profile: Profile, offset: int = 0) -> tuple[list[Any], int]:
    """Decode the Bottle at an offset; return its values and its end. Raises `WireError`, or `Incomplete` if cut off."""
    return (_DECODER3 if profile is Profile.YARP3 else _DECODER4).bottle(data, offset)


def _decoded(data: Buffer, profile: Profile | None, decoder3: Decoder, decoder4: Decoder) -> Any:
    if profile is not None:
        return _whole(decoder3 if profile is Profile.YARP3 else decoder4, data)
    try:
        return _whole(decoder3, data)
    except WireError as err:
        try:
            return _whole(decoder4, data)
        except WireError:
            raise err from None


def _whole(decoder: Decoder, data: Buffer) -> Any:
    values, end = decoder.bottle(data, 0)
    if end != len(data):
        raise WireError(f"the Bottle ends at byte {end}, but {len(data) - end} bytes follow")
    return values

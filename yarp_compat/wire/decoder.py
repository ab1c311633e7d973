"""A Bottle's bytes to plain values, one reader for each profile."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from struct import Struct, unpack_from
from typing import Any

from yarp_compat.wire import tags
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Float32, Int8, Int16, Int64, Key, Vocab, Vocab64

Data = bytes | bytearray | memoryview
Array = Callable[[Data, int, int, str], Any]
"""Makes an array of numbers: from the data, at an offset, so many, of a format character."""

_WORD = Struct("<i").unpack_from
_TWO = Struct("<ii").unpack_from
_INT64 = Struct("<q").unpack_from
_FLOAT = Struct("<f").unpack_from
_DOUBLE = Struct("<d").unpack_from

_INT8 = {value: Int8(value) for value in range(-128, 128)}
_KEPT: dict[str, Callable[[Any], Any]] = {"b": _INT8.__getitem__, "h": Int16, "q": Int64, "f": Float32}
"""What a number is made, of those whose size is not the one that its plain value is written in."""


@lru_cache(1024)
def vocab32(number: int) -> Vocab | bool:
    """The vocab, or truth value, that this number stands for."""
    if number in (0, 0x31):
        return number != 0
    return Vocab(_letters(number.to_bytes(4, "little", signed=True)))


@lru_cache(1024)
def vocab64(number: int) -> Vocab64:
    """The vocab that this number stands for."""
    return Vocab64(_letters(number.to_bytes(8, "little", signed=True)))


def _letters(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="surrogateescape")


class Decoder:
    """Reads the lists of one profile.

    Args:
        profile: whose bytes they are.
        array: makes the numbers of a list of one type, where they are not wanted as a plain list.
    """

    def __init__(self, profile: Profile, array: Array | None = None) -> None:
        self._float32 = profile.float32_tag
        self._float64 = profile.float64_tag
        self._vocab64 = profile.vocab64_tag
        self._formats = tags.formats(profile)
        self._sizes = tags.sizes(profile)
        self._array = array

    def bottle(self, data: Data, offset: int) -> tuple[Any, int]:
        """A Bottle with its header; and where it ends.

        Raises:
            WireError: it is none; Incomplete where the data ends before it does.
        """
        return self._bottle(data, offset, 0)

    def _bottle(self, data: Data, offset: int, depth: int) -> tuple[Any, int]:
        if len(data) - offset < 8:
            raise Incomplete(f"a list's header at byte {offset} needs 8 bytes; there are {len(data) - offset}")
        tag, count = _TWO(data, offset)
        if tag & ~tags.UNIT != tags.LIST:
            raise WireError(f"{tag:#x} at byte {offset} is no list's tag")
        return self._list(data, offset + 8, tag & tags.UNIT, count, depth)

    def _list(self, data: Data, offset: int, unit: int, count: int, depth: int) -> tuple[Any, int]:
        """The elements of a list, of one type where ``unit`` is its tag."""
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
            raise WireError(f"{unit} in a list's tag before byte {offset} is no type's tag")
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
        kept = _KEPT.get(code)
        return list(map(kept, numbers) if kept else numbers), end

    def _blocks(self, data: Data, offset: int, unit: int, count: int) -> tuple[list[Any], int]:
        """Strings or blobs, which have their lengths before them."""
        if len(data) - offset < 4 * count:
            raise Incomplete(f"a list of {count} strings or blobs at byte {offset} needs at least {4 * count} bytes")
        values: list[Any] = []
        whole = len(data)
        for _ in range(count):
            if whole - offset < 4:
                raise Incomplete(f"the length of a string or blob at byte {offset} is missing")
            (length,) = _WORD(data, offset)
            begin = offset + 4
            offset = begin + length
            if length < 0 or offset > whole:
                raise _too_long(length, begin)
            block = data[begin:offset]
            values.append(str(block, "utf-8", "surrogateescape") if unit == tags.STRING else bytes(block))
        return values, offset

    def _mixed(self, data: Data, offset: int, count: int, depth: int) -> tuple[list[Any], int]:
        """Elements each with a tag. All but the smallest have a word after it, which is read with it."""
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
            tag, word = _TWO(data, offset)
            if tag == float64:
                if whole - offset < 12:
                    raise Incomplete(f"a number at byte {offset} needs 12 bytes")
                add(_DOUBLE(data, offset + 4)[0])
                offset += 12
            elif tag == tags.INT32:
                add(word)
                offset += 8
            elif tag in (tags.STRING, tags.BLOB):
                begin = offset + 8
                offset = begin + word
                if word < 0 or offset > whole:
                    raise _too_long(word, begin)
                block = data[begin:offset]
                add(str(block, "utf-8", "surrogateescape") if tag == tags.STRING else bytes(block))
            elif tag & ~tags.UNIT == tags.LIST:
                value, offset = self._list(data, offset + 8, tag & tags.UNIT, word, depth + 1)
                add(value)
            elif tag == tags.VOCAB32:
                add(vocab32(word))
                offset += 8
            else:
                value, offset = self._rare(data, offset, tag, depth)
                add(value)
        return values, offset

    def _rare(self, data: Data, offset: int, tag: int, depth: int) -> tuple[Any, int]:
        """The types that few send."""
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
        raise WireError(f"{tag} at byte {offset} is no type's tag")

    def _small(self, data: Data, offset: int) -> tuple[int, int]:
        """An int of one or two bytes, which may be all that is left."""
        if len(data) - offset < 4:
            raise Incomplete(f"an element's tag at byte {offset} is cut off")
        (tag,) = _WORD(data, offset)
        body = data[offset + 4 : offset + 6]
        if tag == tags.INT8 and len(body) >= 1:
            return _INT8[body[0] - 256 if body[0] > 127 else body[0]], offset + 5
        if tag == tags.INT16 and len(body) == 2:
            return Int16(int.from_bytes(body, "little", signed=True)), offset + 6
        raise Incomplete(f"the element at byte {offset} with the tag {tag} is cut off")

    def _dict(self, data: Data, offset: int, depth: int) -> tuple[dict[str, Any], int]:
        """A Bottle of lists, each a key and its values; YARP skips what is no such list."""
        entries, end = self._bottle(data, offset, depth)
        return dict_of(entries), end


def array(data: Data, offset: int, count: int, code: str) -> Any:
    """A numpy array that looks at the numbers where they are."""
    import numpy as np

    return np.frombuffer(data, f"<{code}", count, offset) if count else np.empty(0, f"<{code}")


def dict_of(entries: list[Any]) -> dict[str, Any]:
    """What lists of a key and its values say; the last of several for a key counts, and other elements do not."""
    found: dict[str, Any] = {}
    for entry in entries:
        if isinstance(entry, list) and entry:
            key, *values = entry
            if type(key) is not str:
                key = _key(key)
                found.pop(key, None)  # else the older key would stay, which may be of another type
            found[key] = values[0] if len(values) == 1 else tuple(values)
    return found


def _key(value: Any) -> Key:
    from yarp_compat.wire.text import plain_text

    return Key.of(value, plain_text(value))


def _too_long(length: int, begin: int) -> WireError:
    if length < 0:
        return WireError(f"the string or blob at byte {begin} has a length of {length}")
    return Incomplete(f"the string or blob of {length} bytes at byte {begin} is cut off")

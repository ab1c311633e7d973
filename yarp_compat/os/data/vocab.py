"""Vocabs: short words encoded as numbers. ``Vocab32.encode("set")`` is 7628147, as in `yarp/os/Vocab32.h`."""

from __future__ import annotations

from yarp_compat.os.data.value_base import code_of, truncate
from yarp_compat.wire.values import Vocab as Word
from yarp_compat.wire.values import vocab32, vocab64


class Vocab32:
    """Words of up to four characters."""

    @staticmethod
    def encode(text: str) -> int:
        """Return the number of a word, of which only the first four bytes count."""
        return code_of(text, 4)

    @staticmethod
    def decode(code: int) -> str:
        """Return the word of a number."""
        return _word(vocab32(truncate(code, 32)))


class Vocab64:
    """Words of up to eight characters (YARP 4)."""

    @staticmethod
    def encode(text: str) -> int:
        """Return the number of a word, of which only the first eight bytes count."""
        return code_of(text, 8)

    @staticmethod
    def decode(code: int) -> str:
        """Return the word of a number."""
        return _word(vocab64(code))

    encode64 = encode
    decode64 = decode


Vocab = Vocab32


def createVocab32(a: str, b: str = "\0", c: str = "\0", d: str = "\0") -> int:
    """Return the number of a word, given by its characters."""
    return code_of(a + b + c + d, 4)


createVocab = createVocab32  # YARP 2's name


def createVocab64(*characters: str) -> int:
    """Return the number of a word, given by up to eight characters (YARP 4)."""
    return code_of("".join(characters), 8)


encode = Vocab32.encode
decode = Vocab32.decode
encode64 = Vocab64.encode
decode64 = Vocab64.decode


def _word(value: Word | bool) -> str:
    return ("1" if value else "") if isinstance(value, bool) else value.replace("\0", "")

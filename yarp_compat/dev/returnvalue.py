"""What a call of an interface came to, which each generation of YARP writes in its own way."""

from __future__ import annotations

import struct
from enum import Enum

from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.tags import INT32, LIST, VOCAB32
from yarp_compat.wire.writer import Writer

_INT64 = struct.Struct("<q")


class ReturnCode(Enum):
    """The outcomes: each with YARP 4's vocab and the number of 3.11 and 3.12 (`yarp/dev/ReturnValue.h`)."""

    OK = "ok", 0
    GENERIC = "err1", 1
    NOT_IMPLEMENTED = "err2", 2
    COMMUNICATION = "err3", 3
    DEPRECATED = "err4", 4
    METHOD_FAILED = "err5", 5
    NOT_READY = "err6", 6
    OUT_OF_BOUNDS = "err7", 1
    UNINITIALIZED = "miss", 100

    @property
    def vocab(self) -> str:
        """YARP 4's word."""
        return self.value[0]

    @property
    def number(self) -> int:
        """The number of 3.11 and 3.12, which knew no bounds."""
        return self.value[1]


_BY_WORD = {**{code.vocab: code for code in ReturnCode}, "fail": ReturnCode.METHOD_FAILED}
_BY_NUMBER = {code.number: code for code in reversed(ReturnCode)}


class ReturnValue(Portable):
    """An outcome; true where the call succeeded.

    Args:
        code: which.
    """

    def __init__(self, code: ReturnCode = ReturnCode.OK) -> None:
        self.code = code

    def __bool__(self) -> bool:
        return self.code is ReturnCode.OK

    def __eq__(self, other: object) -> bool:
        return self.code is other.code if isinstance(other, ReturnValue) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.code)

    def __repr__(self) -> str:
        return f"ReturnValue({self.code.name})"

    def toString(self) -> str:
        """The outcome in words."""
        return self.code.name.lower()

    def _write(self, out: Writer) -> None:
        if out.generation is Generation.YARP_4:
            out.begin(1)
            out.vocab(self.code.vocab)
        elif out.generation is Generation.YARP_3_12:
            out.integer(self.code.number)
        elif out.generation is Generation.YARP_3_11:
            out.raw(_INT64, self.code.number)
        else:
            out.boolean(self)

    def _read(self, source: Reader) -> None:
        if source.generation is Generation.YARP_3_11:
            number = int(source.untagged(_INT64)[0])
            self.code = _BY_NUMBER.get(number, ReturnCode.GENERIC)
            return
        tag = source.next_tag()
        if tag & LIST:
            count = source.begin()
            if count != 1:
                raise WireError(f"an outcome is a list of 1, not {count}")
            word = source.word()
            source.end()
        elif tag == VOCAB32:
            word = source.word()
        elif tag == INT32:
            self.code = _BY_NUMBER.get(source.integer(), ReturnCode.GENERIC)
            return
        else:
            raise WireError(f"expected a call's outcome at byte {source.at}, found tag {tag}")
        if word not in _BY_WORD:
            raise WireError(f"{word!r} before byte {source.at} is no outcome of a call")
        self.code = _BY_WORD[word]


OK = ReturnValue()


class CallFailed(Exception):  # noqa: N818 - what happened, as an implementation says it
    """Raised by an implementation of an interface: the call's outcome is not ok, and its other results do not matter.

    Args:
        code: the outcome.
        reason: for the log.
    """

    def __init__(self, code: ReturnCode = ReturnCode.METHOD_FAILED, reason: str = "") -> None:
        super().__init__(reason or code.name)
        self.code = code

"""The outcome of a call of an interface, which each generation of YARP writes in its own way."""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import Enum
from functools import partial, wraps
from typing import Any, Concatenate, ParamSpec, Self, TypeVar, overload

from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.tags import INT32, LIST, VOCAB32

_INT64 = struct.Struct("<q")
P = ParamSpec("P")
A = TypeVar("A")
T = TypeVar("T")


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
    def vocab_number(self) -> int:
        """The number of that word, which C++ and the bindings have."""
        return int.from_bytes(self.vocab.encode().ljust(4, b"\0"), "little")

    @property
    def number(self) -> int:
        """The number of 3.11 and 3.12, which knew no bounds."""
        return self.value[1]


_BY_WORD = {**{code.vocab: code for code in ReturnCode}, "fail": ReturnCode.METHOD_FAILED}
_BY_NUMBER = {code.number: code for code in reversed(ReturnCode)}


class ReturnValue(Portable):
    """An outcome; true where the call succeeded."""

    def __init__(self, code: ReturnCode | ReturnValue | int = ReturnCode.UNINITIALIZED) -> None:
        if isinstance(code, int):
            code = next((known for known in ReturnCode if known.vocab_number == code), ReturnCode.UNINITIALIZED)
        self.code: ReturnCode = code.code if isinstance(code, ReturnValue) else code

    def __bool__(self) -> bool:
        return self.code is ReturnCode.OK

    def __eq__(self, other: object) -> bool:
        if isinstance(other, int) and not isinstance(other, bool):
            return self.code.vocab_number == other
        return self.code is other.code if isinstance(other, ReturnValue) else NotImplemented

    def __iand__(self, other: ReturnValue) -> Self:
        return type(self)(other if self else self)  # another one: this may be in use elsewhere

    def isEqual(self, other: object) -> bool:
        """Whether it is this outcome, or one of the numbers ``return_code_...`` of this class."""
        return self == other

    def __hash__(self) -> int:
        return hash(self.code.vocab_number)  # as that of the number that it equals

    def __repr__(self) -> str:
        return f"ReturnValue({self.code.name})"

    def toString(self) -> str:
        """The outcome in YARP's words."""
        return _WORDS[self.code]

    toString_c = toString

    def _write(self, out: ElementWriter) -> None:
        if out.generation is Generation.YARP_4:
            out.begin(1)
            out.vocab(self.code.vocab)
        elif out.generation is Generation.YARP_3_12:
            out.integer(self.code.number)
        elif out.generation is Generation.YARP_3_11:
            out.raw(_INT64, self.code.number)
        else:
            out.boolean(self)

    def _read(self, source: ElementReader) -> None:
        if source.generation is Generation.YARP_3_11:
            number = int(source.untagged(_INT64)[0])
            self.code = _BY_NUMBER.get(number, ReturnCode.GENERIC)
            return
        tag = source.next_tag()
        if tag & LIST:
            count = source.begin()
            if count == 0:  # to a client whose generation is a guess, see `yarp_compat.dev.returnvalue`
                source.end()
                self.code = ReturnCode.OK
                return
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


_WORDS = {
    ReturnCode.OK: "ok",
    ReturnCode.GENERIC: "return_value_error_generic",
    ReturnCode.NOT_IMPLEMENTED: "return_value_error_not_implemented_by_device",
    ReturnCode.COMMUNICATION: "return_value_error_nws_nwc_communication_error",
    ReturnCode.DEPRECATED: "return_value_error_deprecated",
    ReturnCode.METHOD_FAILED: "return_value_error_method_failed",
    ReturnCode.NOT_READY: "return_value_error_not_ready",
    ReturnCode.OUT_OF_BOUNDS: "return_value_error_input_out_of_bounds",
    ReturnCode.UNINITIALIZED: "return_value_uninitialized",
}
for _code, _word in _WORDS.items():  # as YARP's bindings name an enumeration inside a class
    _member = "return_value_ok" if _code is ReturnCode.OK else _word
    setattr(ReturnValue, f"return_code_{_member}", _code.vocab_number)

OK = ReturnValue(ReturnCode.OK)


class CallFailed(Exception):  # noqa: N818 - what happened, as an implementation says it
    """Raised by an implementation: the outcome is not ok, other results do not matter; the reason is for the log."""

    def __init__(self, code: ReturnCode = ReturnCode.METHOD_FAILED, reason: str = "") -> None:
        super().__init__(reason or code.name)
        self.code = code


UNREACHED = ReturnValue(ReturnCode.COMMUNICATION)


def called(call: Callable[..., Any], *arguments: Any, into: Any = None) -> ReturnValue:
    """Call a server's method of no result or one, which ``into`` becomes: an object of its class, or a list."""
    outcome, *values = answered(call, *arguments)
    if outcome and values:
        fill(into, values[0])
    return ReturnValue(outcome.code)


def outcome_of(
    method: Callable[Concatenate[Any, P], ReturnValue], server: str = "_remote"
) -> Callable[Concatenate[Any, P], ReturnValue]:
    """A client's method that calls a server's, which returns an outcome alone; ``server`` is the client's attribute."""

    @wraps(method, updated=())
    def call(self: Any, /, *arguments: P.args, **named: P.kwargs) -> ReturnValue:
        return called(partial(getattr(getattr(self, server), method.__name__), **named), *arguments)

    call.__doc__ = f"Call the server's ``{method.__name__}``."
    return call


@overload
def filled(method: Callable[[Any], tuple[ReturnValue, T]]) -> Callable[[Any, T], ReturnValue]: ...
@overload
def filled(method: Callable[[Any, A], tuple[ReturnValue, T]]) -> Callable[[Any, A, T], ReturnValue]: ...
def filled(method: Callable[..., tuple[ReturnValue, Any]]) -> Callable[..., ReturnValue]:
    """A client's method that calls a server's, which returns one value; an object behind the arguments becomes it."""

    @wraps(method, updated=())
    def call(self: Any, /, *arguments: Any) -> ReturnValue:
        *own, into = arguments
        return called(getattr(self._remote, method.__name__), *own, into=into)

    call.__doc__ = f"Call the server's ``{method.__name__}``, whose result the last argument becomes."
    return call


def listed(method: Callable[[Any], tuple[ReturnValue, list[T]]]) -> Callable[..., Any]:
    """A client's method that calls a server's, which returns a list; without a list to fill, returns it as a tuple."""

    @wraps(method, updated=())
    def call(self: Any, into: Any = None) -> Any:
        return asked(getattr(self._remote, method.__name__), into=into, default=())

    call.__doc__ = (
        f"Call the server's ``{method.__name__}``, whose result a list becomes; or return it, empty on failure."
    )
    return call


def asked(call: Callable[..., Any], *arguments: Any, into: Any, default: Any) -> Any:
    """Call a server's method that returns a value: ``into`` becomes it; without ``into`` returns it, or the default."""
    outcome, *values = answered(call, *arguments)
    value = values[0] if outcome else default
    return given(outcome, value, into)


def answered(call: Callable[..., Any], *arguments: Any) -> tuple[Any, ...]:
    """A call's outcome, and its other results."""
    try:
        returned = call(*arguments)
    except (OSError, WireError):
        return (UNREACHED,)
    return (returned,) if isinstance(returned, ReturnValue) else tuple(returned)


def three(call: Callable[[], tuple[ReturnValue, float, float, float]]) -> tuple[ReturnValue, float, float, float]:
    """A call's outcome and three numbers, 0 where it fails."""
    outcome, *numbers = answered(call)
    x, y, theta = numbers if outcome else (0.0, 0.0, 0.0)
    return outcome, x, y, theta


def given(outcome: ReturnValue, value: Any, into: Any) -> Any:
    """A value as the caller wants it: filled in, with the outcome returned; or by itself, a list as a tuple."""
    if into is None:
        return tuple(value) if isinstance(value, list) else value
    if outcome:
        fill(into, value)
    return ReturnValue(outcome.code)


def fill(into: Any, value: Any) -> None:
    """Have something be as a value is."""
    if isinstance(into, list):
        into[:] = value if isinstance(value, list) else [value]
    else:
        into._become(value)


SPARE = 4  # bytes that the acknowledgement behind an outcome of `alone` has to say

_SUCCESS = struct.pack("<ii", LIST | INT32, 0)
_FAILURE = struct.Struct("<i")


class Refused(ReturnValue):
    """A failure that each generation reads as one; what failed is lost to some."""

    def _write(self, out: ElementWriter) -> None:
        if out.generation is Generation.YARP_4:
            out.begin(1)
        out.vocab("fail")


def alone(outcome: ReturnValue) -> bytes:
    """The reply that is nothing but an outcome, over a carrier with acknowledgements."""
    return _SUCCESS if outcome else _FAILURE.pack(outcome.code.number)

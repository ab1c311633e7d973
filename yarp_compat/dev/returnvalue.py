"""The outcome of an interface's method call, which each generation of YARP encodes differently."""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import Enum
from functools import partial, wraps
from typing import Any, Concatenate, ParamSpec, Self, TypeVar, overload

from yarp_compat.overriding import override
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
    """The outcomes, each with YARP 4's vocab and the number of 3.11 and 3.12 (`yarp/dev/ReturnValue.h`)."""

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
        """YARP 4's vocab."""
        return self.value[0]

    @property
    def vocab_number(self) -> int:
        """The number of the vocab, which is the value in C++ and the bindings."""
        return int.from_bytes(self.vocab.encode().ljust(4, b"\0"), "little")

    @property
    def number(self) -> int:
        """The number in 3.11 and 3.12, which have no out-of-bounds outcome."""
        return self.value[1]


_BY_VOCAB = {**{code.vocab: code for code in ReturnCode}, "fail": ReturnCode.METHOD_FAILED}
_BY_NUMBER = {code.number: code for code in reversed(ReturnCode)}


class ReturnValue(Portable):
    """An outcome; true if the call succeeded."""

    def __init__(self, code: ReturnCode | ReturnValue | int = ReturnCode.UNINITIALIZED) -> None:
        if isinstance(code, int):
            code = next((known for known in ReturnCode if known.vocab_number == code), ReturnCode.UNINITIALIZED)
        self.code: ReturnCode = code.code if isinstance(code, ReturnValue) else code

    def __bool__(self) -> bool:
        return self.code is ReturnCode.OK

    @override
    def __eq__(self, other: object) -> bool:
        if isinstance(other, int) and not isinstance(other, bool):
            return self.code.vocab_number == other
        return self.code is other.code if isinstance(other, ReturnValue) else NotImplemented

    def __iand__(self, other: ReturnValue) -> Self:
        return type(self)(other if self else self)  # a new object, because this one may be shared

    def isEqual(self, other: object) -> bool:
        """Whether ``other`` is the same outcome, or its number (``return_code_...`` of this class)."""
        return self == other

    @override
    def __hash__(self) -> int:
        return hash(self.code.vocab_number)  # an outcome equals its number, so their hashes must be equal

    @override
    def __repr__(self) -> str:
        return f"ReturnValue({self.code.name})"

    def toString(self) -> str:
        """Return YARP's name of the outcome."""
        return _NAMES[self.code]

    toString_c = toString

    @override
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

    @override
    def _read(self, source: ElementReader) -> None:
        if source.generation is Generation.YARP_3_11:
            number = int(source.untagged(_INT64)[0])
            self.code = _BY_NUMBER.get(number, ReturnCode.GENERIC)
            return
        tag = source.next_tag()
        if tag & LIST:
            count = source.begin()
            if count == 0:  # `outcome_only`'s reply to a client whose generation is a guess
                source.end()
                self.code = ReturnCode.OK
                return
            if count != 1:
                raise WireError(f"an outcome must be a list of 1, not {count}")
            vocab = source.word()
            source.end()
        elif tag == VOCAB32:
            vocab = source.word()
        elif tag == INT32:
            self.code = _BY_NUMBER.get(source.integer(), ReturnCode.GENERIC)
            return
        else:
            raise WireError(f"expected a call's outcome at byte {source.at}, found tag {tag}")
        if vocab not in _BY_VOCAB:
            raise WireError(f"{vocab!r} before byte {source.at} is not the outcome of a call")
        self.code = _BY_VOCAB[vocab]


_NAMES = {
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
for _code, _name in _NAMES.items():  # as YARP's bindings name an enumeration inside a class
    _member = "return_value_ok" if _code is ReturnCode.OK else _name
    setattr(ReturnValue, f"return_code_{_member}", _code.vocab_number)

OK = ReturnValue(ReturnCode.OK)


class CallFailed(Exception):  # noqa: N818 - names the event
    """Raised by a service's method to reply with a failure and default results; the reason is logged."""

    def __init__(self, code: ReturnCode = ReturnCode.METHOD_FAILED, reason: str = "") -> None:
        super().__init__(reason or code.name)
        self.code = code


UNREACHED = ReturnValue(ReturnCode.COMMUNICATION)


def invoke(call: Callable[..., Any], *arguments: Any, into: Any = None) -> ReturnValue:
    """Call a server's method and return its outcome; fill ``into`` (an object or a list) with its result, if any."""
    outcome, *values = results_of(call, *arguments)
    if outcome and values:
        fill(into, values[0])
    return ReturnValue(outcome.code)


def outcome_of(
    method: Callable[Concatenate[Any, P], ReturnValue], server: str = "_remote"
) -> Callable[Concatenate[Any, P], ReturnValue]:
    """Make a client method for a server method that returns only an outcome; ``server`` is the client's attribute."""

    @wraps(method, updated=())
    def call(self: Any, /, *arguments: P.args, **named: P.kwargs) -> ReturnValue:
        return invoke(partial(getattr(getattr(self, server), method.__name__), **named), *arguments)

    call.__doc__ = f"Call the server's ``{method.__name__}``."
    return call


@overload
def filled(method: Callable[[Any], tuple[ReturnValue, T]]) -> Callable[[Any, T], ReturnValue]: ...
@overload
def filled(method: Callable[[Any, A], tuple[ReturnValue, T]]) -> Callable[[Any, A, T], ReturnValue]: ...
def filled(method: Callable[..., tuple[ReturnValue, Any]]) -> Callable[..., ReturnValue]:
    """Make a client method for a server method that returns one value, which is copied into the last argument."""

    @wraps(method, updated=())
    def call(self: Any, /, *arguments: Any) -> ReturnValue:
        *inputs, into = arguments
        return invoke(getattr(self._remote, method.__name__), *inputs, into=into)

    call.__doc__ = f"Call the server's ``{method.__name__}``, and copy its result into the last argument."
    return call


def listed(method: Callable[[Any], tuple[ReturnValue, list[T]]]) -> Callable[..., Any]:
    """Make a client method for a server method that returns a list; without a list to fill, it returns a tuple."""

    @wraps(method, updated=())
    def call(self: Any, into: Any = None) -> Any:
        return fetch(getattr(self._remote, method.__name__), into=into, default=())

    call.__doc__ = (
        f"Call the server's ``{method.__name__}``, and fill a list with its result or return it, empty on failure."
    )
    return call


def fetch(call: Callable[..., Any], *arguments: Any, into: Any, default: Any) -> Any:
    """Call a server's method, and fill ``into`` with its value; without ``into``, return it, the default on failure."""
    outcome, *values = results_of(call, *arguments)
    value = values[0] if outcome else default
    return deliver(outcome, value, into)


def results_of(call: Callable[..., Any], *arguments: Any) -> tuple[Any, ...]:
    """Return a call's outcome and its other results."""
    try:
        returned = call(*arguments)
    except (OSError, WireError):
        return (UNREACHED,)
    return (returned,) if isinstance(returned, ReturnValue) else tuple(returned)


def fetch_three(call: Callable[[], tuple[ReturnValue, float, float, float]]) -> tuple[ReturnValue, float, float, float]:
    """Return a call's outcome and its three numbers, 0 if it fails."""
    outcome, *numbers = results_of(call)
    x, y, theta = numbers if outcome else (0.0, 0.0, 0.0)
    return outcome, x, y, theta


def deliver(outcome: ReturnValue, value: Any, into: Any) -> Any:
    """Fill ``into`` with a value and return the outcome; without ``into`` return the value, a list as a tuple."""
    if into is None:
        return tuple(value) if isinstance(value, list) else value
    if outcome:
        fill(into, value)
    return ReturnValue(outcome.code)


def fill(into: Any, value: Any) -> None:
    """Copy a value into an object, or into a list as its content or only element."""
    if isinstance(into, list):
        into[:] = value if isinstance(value, list) else [value]
    else:
        into._become(value)


SPARE = 4  # bytes that the acknowledgment after an outcome of `outcome_only` must announce

_SUCCESS = struct.pack("<ii", LIST | INT32, 0)
_FAILURE = struct.Struct("<i")


class Refused(ReturnValue):
    """A failure that each generation reads as a failure, some without its code."""

    @override
    def _write(self, out: ElementWriter) -> None:
        if out.generation is Generation.YARP_4:
            out.begin(1)
        out.vocab("fail")


def outcome_only(outcome: ReturnValue) -> bytes:
    """Return the reply that consists of an outcome only, for a carrier with acknowledgments."""
    return _SUCCESS if outcome else _FAILURE.pack(outcome.code.number)

"""Calls of a server as YARP's interfaces give them: an outcome, and what C++ returns by reference filled in.

A truth, a number or a text, which Python cannot fill, goes into a list (`BVector`, `DVector`, `SVector`) as its one
element. Without anything to fill a method returns the value itself, as YARP's bindings do; where the call fails, what
C++ has where nothing was set. Nothing raises.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue
from yarp_compat.wire.errors import WireError

UNREACHED = ReturnValue(ReturnCode.COMMUNICATION)


def called(call: Callable[..., Any], *arguments: Any, into: Any = None) -> ReturnValue:
    """Call a server's method that returns nothing, or one value that can be filled in.

    Args:
        call: the method.
        arguments: its own.
        into: what is filled in: an object of the value's class, or a list where the value is one.
    """
    outcome, *values = answered(call, *arguments)
    if outcome and values:
        fill(into, values[0])
    return ReturnValue(outcome.code)


def asked(call: Callable[..., Any], *arguments: Any, into: Any, default: Any) -> Any:
    """Call a server's method that returns one value.

    Args:
        call: the method.
        arguments: its own.
        into: what is filled in; None: the value is returned.
        default: the value where the call fails.
    """
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


def given(outcome: ReturnValue, value: Any, into: Any) -> Any:
    """A value as the caller wants it: filled in, with the outcome returned; or by itself."""
    if into is None:
        return value
    if outcome:
        fill(into, value)
    return ReturnValue(outcome.code)


def fill(into: Any, value: Any) -> None:
    """Have something be as a value is."""
    if isinstance(into, list):
        into[:] = value if isinstance(value, list) else [value]
    else:
        into._become(value)

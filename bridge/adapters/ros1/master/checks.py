"""Checks of the parameters of the master API's calls, with ``rosmaster``'s text for each error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.adapters.ros1.master.names import ANY_TYPE, resolve

Check = Callable[[Any, str], Any]
"""Checks a value from a node, and returns it in the form that the method expects; raises `InvalidError`."""

MAX_NAME = 2048
"""Maximum length of a name or address in characters."""


class InvalidError(Exception):
    """A parameter of a call is invalid."""


def text(parameter: str) -> Check:
    """Accept a string that is not empty."""

    def check(value: Any, _caller: str) -> str:
        if not value:
            raise InvalidError(f"ERROR: parameter [{parameter}] must be specified and non-empty")
        if not isinstance(value, str):
            raise InvalidError(f"ERROR: parameter [{parameter}] must be a string")
        return short(parameter, value)

    return check


def given(parameter: str) -> Check:
    """Accept any value but None."""

    def check(value: Any, _caller: str) -> Any:
        if value is None:
            raise InvalidError(f"ERROR: parameter [{parameter}] must be specified")
        return value

    return check


def anything(value: Any, _caller: str) -> Any:
    """Accept any value."""
    return value


def address(parameter: str) -> Check:
    """Accept the address of a node or a service."""

    def check(value: Any, _caller: str) -> str:
        if not value or not isinstance(value, str):
            raise InvalidError(f"ERROR: parameter [{parameter}] is not an XMLRPC URI")
        if not value.startswith(("http://", "rosrpc://")):
            raise InvalidError(f"ERROR: parameter [{parameter}] is not an RPC URI")
        return short(parameter, value)

    return check


def name(parameter: str, *, root: bool = False) -> Check:
    """Accept a name, and resolve it for the calling node; ``root``: also accept the global namespace."""

    def check(value: Any, caller: str) -> str:
        if not value or not isinstance(value, str):
            raise InvalidError(f"ERROR: parameter [{parameter}] must be a non-empty string")
        if ":" in value or " " in value:
            raise InvalidError(f"ERROR: parameter [{parameter}] contains illegal chars")
        if value == "/" and not root:
            raise InvalidError(f"ERROR: parameter [{parameter}] cannot be the global namespace")
        return resolve(short(parameter, value), caller)

    return check


def namespace(parameter: str) -> Check:
    """Accept a namespace, and resolve it for the calling node; "" stands for all names."""

    def check(value: Any, caller: str) -> str:
        if not isinstance(value, str):
            raise InvalidError(f"ERROR: parameter [{parameter}] must be a string")
        return resolve(short(parameter, value), caller) if value else ""

    return check


def type_name(parameter: str) -> Check:
    """Accept the name of a message type, or ``*`` for any."""

    def check(value: Any, _caller: str) -> str:
        if value == ANY_TYPE:
            return ANY_TYPE
        if not value or not isinstance(value, str):
            raise InvalidError(f"ERROR: parameter [{parameter}] must be a non-empty string")
        if value.count("/") != 1:
            raise InvalidError(f"ERROR: parameter [{parameter}] is not a valid package resource name")
        return short(parameter, value)

    return check


def short(parameter: str, value: str) -> str:
    """Accept a string of limited length."""
    if len(value) > MAX_NAME:
        raise InvalidError(f"ERROR: parameter [{parameter}] is longer than {MAX_NAME} characters")
    return value

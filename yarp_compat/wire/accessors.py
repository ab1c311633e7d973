"""Methods that YARP has for what Python reads as an attribute: one line each, typed, with its documentation."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any, TypeVar

T = TypeVar("T")


def getter(attribute: str, kind: Callable[..., T], doc: str) -> Callable[[Any], T]:  # noqa: ARG001 - for the type checker
    """A method that returns an attribute (``_address.host``: an attribute's attribute) of a kind."""
    read = attrgetter(attribute)

    def get(self: Any) -> T:
        found: T = read(self)
        return found

    get.__doc__ = doc
    return get


def setter(attribute: str, kind: Callable[..., T], doc: str) -> Callable[[Any, T], None]:  # noqa: ARG001 - as above
    """A method that sets an attribute of a kind."""

    def set_to(self: Any, value: T) -> None:
        setattr(self, attribute, value)

    set_to.__doc__ = doc
    return set_to


def always(value: T, doc: str) -> Callable[[Any], T]:
    """A method that always returns this."""

    def get(self: Any) -> T:  # noqa: ARG001
        return value

    get.__doc__ = doc
    return get

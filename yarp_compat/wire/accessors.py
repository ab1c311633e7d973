"""Factories for YARP's getters and setters of attributes: typed and documented methods in one line each."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any, TypeVar

T = TypeVar("T")


def getter(attribute: str, kind: Callable[..., T], doc: str) -> Callable[[Any], T]:  # noqa: ARG001 - for the type checker
    """Return a method that returns an attribute of the type ``kind``; the name may have dots: ``_address.host``."""
    read = attrgetter(attribute)

    def get(self: Any) -> T:
        value: T = read(self)
        return value

    get.__doc__ = doc
    return get


def setter(attribute: str, kind: Callable[..., T], doc: str) -> Callable[[Any, T], None]:  # noqa: ARG001 - as above
    """Return a method that sets an attribute of the type ``kind``."""

    def set_to(self: Any, value: T) -> None:
        setattr(self, attribute, value)

    set_to.__doc__ = doc
    return set_to


def always(value: T, doc: str) -> Callable[[Any], T]:
    """Return a method that always returns ``value``."""

    def get(self: Any) -> T:  # noqa: ARG001
        return value

    get.__doc__ = doc
    return get

"""The descriptors that packages register, of sides, workers, modules and console views.

A package registers a descriptor with an entry point in a group such as ``midspan.sides``, or in an environment variable
such as ``$MIDSPAN_SIDES`` (``package.module:NAME,...``).
"""

from __future__ import annotations

import functools
import importlib
import os
from collections.abc import Iterable
from importlib.metadata import entry_points
from typing import Any, Protocol, TypeVar


class Named(Protocol):
    """A descriptor with a name."""

    @property
    def name(self) -> str:
        """The name, which is unique among the descriptors of one kind."""


Kind = TypeVar("Kind", bound=Named)


def imported(place: str) -> Any:
    """Import the object named by ``package.module:name``."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


@functools.cache
def _entry_points() -> Any:
    """Return the entry points of all packages; reading them takes 10 ms."""
    return entry_points()


def registered(kind: type[Kind], word: str, taken: Iterable[str]) -> tuple[Kind, ...]:
    """Return the descriptors that do not ship with Midspan.

    Args:
        kind: class of the descriptors.
        word: ``side``, ``worker``, ``module`` or ``view``.
        taken: names of the descriptors that ship with Midspan.

    Raises:
        RuntimeError: a descriptor cannot be imported, has another type, or has the same name as another.
    """
    places = [point.value for point in _entry_points().select(group=f"midspan.{word}s")]
    places += [place.strip() for place in os.environ.get(f"MIDSPAN_{word.upper()}S", "").split(",")]
    descriptors: dict[str, Kind] = {}
    names = set(taken)
    for place in dict.fromkeys(places):
        if not place or "=" in place:  # $MIDSPAN_WORKERS also replaces workers: NAME=package.module:Class
            continue
        try:
            descriptor = imported(place)
        except (ImportError, AttributeError, ValueError) as err:
            raise RuntimeError(f"the {word} {place} cannot be imported: {err}") from err
        if not isinstance(descriptor, kind):
            raise RuntimeError(f"the {word} {place} is not a {kind.__module__}.{kind.__name__}")  # noqa: TRY004
        if descriptor.name in names | descriptors.keys():
            raise RuntimeError(f"the {word} {place}: there is already a {word} named {descriptor.name}")
        descriptors[descriptor.name] = descriptor
    return tuple(descriptors.values())

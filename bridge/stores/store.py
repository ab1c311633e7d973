"""The store as modules use it: maps, locations and the like as values.

What is written is on the disk when the call returns, and on its way to the other machines; see `bridge.stores.sharing`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from bridge.stores.entry import StoreError, check_name
from bridge.stores.kinds import AREA, BEHAVIOUR, CURRENT, LOCATION, MAP, OBJECT, PATH, ValueKind
from bridge.stores.replica import Body, Change, OnChange, Key, Replica
from yarp_compat.dev.extras import AreaBehaviour

__all__ = ["Change", "Store", "Write"]

T = TypeVar("T")

THE_MAP = "map"
_COMPANIONS: dict[str, ValueKind[Any]] = {AREA.name: BEHAVIOUR}  # what goes where a key of another kind goes


@dataclass(frozen=True, slots=True)
class Write(Generic[T]):
    """A value to be written under a name, or deleted where it is None."""

    kind: ValueKind[T]
    name: str
    value: T | None


class Values(Protocol):
    """The store, or a client of it."""

    def get(self, kind: ValueKind[T], name: str) -> T | None:
        """A value, None where there is none."""

    def all(self, kind: ValueKind[T]) -> dict[str, T]:
        """All values of a kind."""

    def names(self, kind: ValueKind[Any]) -> list[str]:
        """The names of a kind's values."""

    def current_map(self) -> str:
        """The name of the map that is in use, "" where none was chosen."""


def rename_writes(values: Values, kind: ValueKind[Any], old: str, new: str) -> list[Write[Any]]:
    """What gives a value another name; raises `StoreError` where the old one is not there or the new one is.

    What an area asks of robots goes along; so do, with a map, the places that are on it.
    """
    value = values.get(kind, old)
    if value is None:
        raise StoreError(f"there is no {kind.name} {old!r}")
    if check_name(new) in values.names(kind):
        raise StoreError(f"{kind.name} {new!r} is there already")
    writes: list[Write[Any]] = [Write(kind, new, value), Write(kind, old, None)]
    companion = _COMPANIONS.get(kind.name)
    companion_value = None if companion is None else values.get(companion, old)
    if companion is not None and companion_value is not None:
        writes.append(Write(companion, new, companion_value))
    return writes + (_moved(values, old, new) if kind is MAP else [])


def _moved(values: Values, old: str, new: str) -> list[Write[Any]]:
    """What brings the places of a map to another one, and chooses that where the map was in use."""
    writes: list[Write[Any]] = []
    kinds: tuple[ValueKind[Any], ...] = (LOCATION, AREA, OBJECT)
    for kind in kinds:
        on_map = {name: value for name, value in values.all(kind).items() if value.map_id == old}
        writes += [Write(kind, name, replace(value, map_id=new)) for name, value in on_map.items()]
    for name, path in values.all(PATH).items():
        if any(point.map_id == old for point in path.waypoints):
            points = [replace(point, map_id=new) if point.map_id == old else point for point in path.waypoints]
            writes.append(Write(PATH, name, replace(path, waypoints=points)))
    if values.current_map() == old:
        writes.append(Write(CURRENT, THE_MAP, new))
    return writes


class Store:
    """Values by kind and name. Safe to use from any thread."""

    def __init__(self, replica: Replica) -> None:
        self.replica = replica

    def get(self, kind: ValueKind[T], name: str) -> T | None:
        """A value, a copy of the caller's own; None where the store has none."""
        body = self.replica.get(kind.name, name)
        return None if body is None else kind.decode(name, body[0])

    def names(self, kind: ValueKind[Any]) -> list[str]:
        """The names of a kind's values, sorted."""
        return self.replica.names(kind.name)

    def all(self, kind: ValueKind[T]) -> dict[str, T]:
        """All values of a kind, in the order of their names."""
        values = {name: self.get(kind, name) for name in self.names(kind)}
        return {name: value for name, value in values.items() if value is not None}

    def put(self, kind: ValueKind[T], name: str, value: T) -> None:
        """Write a value; raises `StoreError` where its name, its size or the value itself cannot be."""
        self.write([Write(kind, name, value)])

    def delete(self, kind: ValueKind[Any], name: str) -> bool:
        """Delete a value; whether there was one."""
        with self.replica.still():
            exists = self.replica.has(kind.name, name)
            if exists:
                self.write([Write(kind, name, None)])
        return exists

    def clear(self, kind: ValueKind[Any]) -> int:
        """Delete all values of a kind; how many there were."""
        names = self.names(kind)
        self.write([Write(kind, name, None) for name in names])
        return len(names)

    def rename(self, kind: ValueKind[Any], old: str, new: str) -> None:
        """Give a value another name; raises `StoreError` where the old one is not there or the new one is."""
        with self.replica.still():
            self.write(rename_writes(self, kind, old, new))

    def write(self, writes: Sequence[Write[Any]]) -> None:
        """Write and delete in one transaction, of a key the last; raises `StoreError`, and nothing has changed."""
        changes: dict[Key, Body | None] = {}
        for write_ in writes:
            kind, name = write_.kind, check_name(write_.name)
            changes[kind.name, name] = None if write_.value is None else kind.encode(name, write_.value)
        write_all(self.replica, changes)

    def behaviour(self, area: str) -> AreaBehaviour:
        """What an area asks of robots: as it is kept beside it, else as its description has it; nothing by default."""
        stored = self.get(BEHAVIOUR, area)
        described = self.get(AREA, area) if stored is None else None
        if described is None:
            return stored or AreaBehaviour()
        try:
            return AreaBehaviour.from_text(described.description) or AreaBehaviour()
        except ValueError as err:
            raise StoreError(f"area {area!r}: {err}") from None

    def current_map(self) -> str:
        """The name of the map that is in use, "" where none was chosen."""
        return self.get(CURRENT, THE_MAP) or ""

    def use_map(self, name: str) -> None:
        """Choose the map that is in use; raises `StoreError` where none has the name."""
        if not self.replica.has(MAP.name, name):
            raise StoreError(f"there is no map {name!r}; those that are: {', '.join(self.names(MAP)) or 'none'}")
        self.put(CURRENT, THE_MAP, name)

    def watch(self, on_change: OnChange, *kinds: ValueKind[Any]) -> Callable[[], None]:
        """As `Replica.watch`, by kinds; none: of all."""
        return self.replica.watch(on_change, [kind.name for kind in kinds])

    def status(self) -> dict[str, Any]:
        """What it holds, for the status document."""
        return self.replica.status()


def write_all(replica: Replica, changes: Mapping[Key, Body | None]) -> None:
    """Write what was checked, delete what goes beside a deleted key; raises `StoreError`, and nothing has changed."""
    companions = {
        (_COMPANIONS[kind].name, name): None for (kind, name), body in changes.items() if not body and kind in _COMPANIONS
    }
    with replica.still():
        replica.write({key: body for key, body in (companions | dict(changes)).items() if body or replica.has(*key)})

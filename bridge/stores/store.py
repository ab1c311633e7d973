"""The store as modules use it: maps, locations and the like as Python values.

A change is on the disk when the call returns; other machines receive it soon after, see `bridge.stores.sharing`.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

from bridge.module_keys import StoreContent
from bridge.stores.entry import StoreError, check_name, json_object
from bridge.stores.kinds import AREA, BEHAVIOR, CURRENT, LOCATION, MAP, OBJECT, PATH, ValueKind
from bridge.stores.replica import Body, Change, Key, OnChange, Replica
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.locations import Map2DArea

__all__ = ["Change", "MapAreas", "Store", "Write"]

T = TypeVar("T")

THE_MAP = "map"
_COMPANIONS: dict[str, ValueKind[Any]] = {AREA.name: BEHAVIOR}  # deleted and renamed with a key of the first kind


@dataclass(frozen=True, slots=True)
class Write(Generic[T]):
    """A value to write under a name, or a deletion if the value is None."""

    kind: ValueKind[T]
    name: str
    value: T | None


class Values(Protocol):
    """The store, or a client of it."""

    def get(self, kind: ValueKind[T], name: str) -> T | None:
        """Return a value, None if it does not exist."""

    def all(self, kind: ValueKind[T]) -> dict[str, T]:
        """Return all values of a kind."""

    def names(self, kind: ValueKind[Any]) -> list[str]:
        """Return the names of a kind's values."""

    def current_map(self) -> str:
        """Return the name of the current map, "" if none was chosen."""


def rename_writes(values: Values, kind: ValueKind[Any], old: str, new: str) -> list[Write[Any]]:
    """Return the writes that rename a value; raises `StoreError` if the old name does not exist or the new one does.

    An area is renamed with its rules, a map with the places on it.
    """
    value = values.get(kind, old)
    if value is None:
        raise StoreError(f"no {kind.name} {old!r}")
    if check_name(new) in values.names(kind):
        raise StoreError(f"{kind.name} {new!r} exists already")
    writes: list[Write[Any]] = [Write(kind, new, value), Write(kind, old, None)]
    companion = _COMPANIONS.get(kind.name)
    companion_value = None if companion is None else values.get(companion, old)
    if companion is not None and companion_value is not None:
        writes.append(Write(companion, new, companion_value))
    return writes + (_move_writes(values, old, new) if kind is MAP else [])


def moved(write: Write[Any], old: str, new: str) -> Write[Any]:
    """Return a write of map ``old``, or of a place on it, for the map's name ``new``; other writes as they are."""
    value: Any = write.value
    if write.kind is MAP and write.name == old:
        return Write(MAP, new, value)
    if write.kind in (LOCATION, AREA, OBJECT) and value.map_id == old:
        return Write(write.kind, write.name, replace(value, map_id=new))
    if write.kind is PATH and any(point.map_id == old for point in value.waypoints):
        points = [replace(point, map_id=new) if point.map_id == old else point for point in value.waypoints]
        return Write(PATH, write.name, replace(value, waypoints=points))
    return write


def _move_writes(values: Values, old: str, new: str) -> list[Write[Any]]:
    """Return the writes that move the places of map ``old`` to ``new``, and choose ``new`` if ``old`` is current."""
    kinds: tuple[ValueKind[Any], ...] = (LOCATION, AREA, OBJECT, PATH)
    places = [Write(kind, name, value) for kind in kinds for name, value in values.all(kind).items()]
    writes = [write for place in places if (write := moved(place, old, new)) is not place]
    if values.current_map() == old:
        writes.append(Write(CURRENT, THE_MAP, new))
    return writes


_CLOSED = AreaBehavior(keep_out=True)
_MOST_WARNINGS = 10


@dataclass(frozen=True, slots=True)
class MapAreas:
    """The areas on a map; robots keep out of areas that cannot be read."""

    #: each area with its behavior, by name; the behavior is keep-out if it cannot be read
    named: Mapping[str, tuple[Map2DArea, AreaBehavior]] = field(default_factory=dict)
    closed: str = ""  #: why robots must not drive on the map at all: an area that may be on it cannot be read
    warnings: tuple[str, ...] = ()  #: the behaviors that cannot be read, with the cure; the first ten

    @property
    def keep_out(self) -> list[Map2DArea]:
        """The areas that robots keep out of."""
        return [area for area, behavior in self.named.values() if behavior.keep_out]

    @property
    def troubles(self) -> tuple[str, ...]:
        """What cannot be read, with the cure, for the log."""
        return (self.closed, *self.warnings) if self.closed else self.warnings


class Store:
    """Values by kind and name. Safe to use from any thread."""

    def __init__(self, replica: Replica) -> None:
        self.replica = replica

    def get(self, kind: ValueKind[T], name: str) -> T | None:
        """Return a copy of a value, None if it does not exist."""
        body = self.replica.get(kind.name, name)
        return None if body is None else kind.decode(name, body[0])

    def names(self, kind: ValueKind[Any]) -> list[str]:
        """Return the names of a kind's values, sorted."""
        return self.replica.names(kind.name)

    def all(self, kind: ValueKind[T]) -> dict[str, T]:
        """Return all values of a kind, sorted by name."""
        values = {name: self.get(kind, name) for name in self.names(kind)}
        return {name: value for name, value in values.items() if value is not None}

    def put(self, kind: ValueKind[T], name: str, value: T) -> None:
        """Write a value; raises `StoreError` if its name, its size or the value itself is invalid."""
        self.write([Write(kind, name, value)])

    def delete(self, kind: ValueKind[Any], name: str) -> bool:
        """Delete a value; return whether it existed."""
        with self.replica.locked():
            exists = self.replica.has(kind.name, name)
            if exists:
                self.write([Write(kind, name, None)])
        return exists

    def clear(self, kind: ValueKind[Any]) -> int:
        """Delete all values of a kind; return their number."""
        names = self.names(kind)
        self.write([Write(kind, name, None) for name in names])
        return len(names)

    def rename(self, kind: ValueKind[Any], old: str, new: str) -> None:
        """Rename a value; raises `StoreError` if the old name does not exist or the new one does."""
        with self.replica.locked():
            self.write(rename_writes(self, kind, old, new))

    def write(self, writes: Sequence[Write[Any]]) -> None:
        """Write and delete in one transaction (the last change of a key applies); `StoreError` means no change."""
        changes: dict[Key, Body | None] = {}
        for write_ in writes:
            kind, name = write_.kind, check_name(write_.name)
            changes[kind.name, name] = None if write_.value is None else kind.encode(name, write_.value)
        write_all(self.replica, changes)

    def behavior(self, area: str) -> AreaBehavior:
        """Return an area's rules for robots: as stored, else from its description, else the defaults."""
        stored = self.get(BEHAVIOR, area)
        described = self.get(AREA, area) if stored is None else None
        if described is None:
            return stored or AreaBehavior()
        try:
            return AreaBehavior.from_text(described.description) or AreaBehavior()
        except ValueError as err:
            raise StoreError(f"area {area!r}: {err}") from None

    def areas(self, map_name: str) -> MapAreas:
        """Return the areas on a map with their behaviors. Robots keep out of areas that cannot be read."""
        named: dict[str, tuple[Map2DArea, AreaBehavior]] = {}
        unread: list[str] = []
        warnings: list[str] = []
        for name in self.names(AREA):
            try:
                area = self.get(AREA, name)
            except StoreError as err:
                if self._map_of(name) in (map_name, None):
                    unread.append(self._cure(name, err))
                continue
            if area is None or area.map_id != map_name:
                continue
            try:
                behavior = self.behavior(name)
            except StoreError as err:
                behavior = _CLOSED
                warnings.append(f"robots keep out of the area {name!r}, since {self._cure(name, err)}")
            named[name] = area, behavior
        closed = ""
        if unread:
            more = f"; {len(unread) - 1} more areas cannot be read" if len(unread) > 1 else ""
            closed = f"robots keep out of the map {map_name!r}, since an area on it cannot be read: {unread[0]}{more}"
        return MapAreas(named, closed, tuple(warnings[:_MOST_WARNINGS]))

    def _cure(self, area: str, err: StoreError) -> str:
        remove = f"midspan location remove --kind area {shlex.quote(area)}"
        return f"{err} (in {self.replica.file}); store it again, or remove it: {remove}"

    def _map_of(self, area: str) -> str | None:
        """Return the name of the map of an area that cannot be read; None if the name cannot be read either."""
        try:
            body = self.replica.get(AREA.name, area)
            map_name = None if body is None else json_object(body[0]).get("map")
        except StoreError:
            return None
        return map_name if isinstance(map_name, str) else None

    def current_map(self) -> str:
        """Return the name of the current map, "" if none was chosen."""
        return self.get(CURRENT, THE_MAP) or ""

    def use_map(self, name: str) -> None:
        """Choose the current map; raises `StoreError` if the map does not exist."""
        if not self.replica.has(MAP.name, name):
            raise StoreError(f"no map {name!r}; existing maps: {', '.join(self.names(MAP)) or 'none'}")
        self.put(CURRENT, THE_MAP, name)

    def watch(self, on_change: OnChange, *kinds: ValueKind[Any]) -> Callable[[], None]:
        """Call back for every change of these kinds, of all if none are given; see `Replica.watch`."""
        return self.replica.watch(on_change, [kind.name for kind in kinds])

    def status(self) -> StoreContent:
        """Return the content's summary for the status document."""
        return self.replica.status()


def write_all(replica: Replica, changes: Mapping[Key, Body | None]) -> None:
    """Write encoded values, and delete the companions of deleted keys; `StoreError` means no change."""
    companions = {
        (_COMPANIONS[kind].name, name): None
        for (kind, name), body in changes.items()
        if not body and kind in _COMPANIONS
    }
    with replica.locked():
        replica.write({key: body for key, body in (companions | dict(changes)).items() if body or replica.has(*key)})

"""What the store holds: each kind of value, and how it is written as bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from bridge.stores import places
from bridge.stores.errors import StoreError
from bridge.stores.mapform import read_map, write_map
from yarp_compat.dev.area_behaviour import AreaBehaviour
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.maplink import MapLink

JSON = "application/json"
GRID = "application/octet-stream;midspan-map"

T = TypeVar("T")

_SMALL, _LARGE = 1 << 20, 64 << 20


@dataclass(frozen=True, slots=True)
class Kind(Generic[T]):
    """One kind of value.

    Attributes:
        name: as it stands in keys.
        encoding: of its bodies.
        limit: bytes of the largest body.
        write: the body of a value that is stored under a name; raises `StoreError`.
        read: the other way round; raises `StoreError`.
    """

    name: str
    encoding: str
    limit: int
    write: Callable[[str, T], bytes]
    read: Callable[[str, bytes], T]

    def encode(self, name: str, value: T) -> tuple[bytes, str]:
        """A value's body and encoding; raises `StoreError`."""
        try:
            body = self.write(name, value)
        except StoreError as err:
            raise StoreError(f"{self.name} {name!r}: {err}") from None
        self._check_size(name, body)
        return body, self.encoding

    def decode(self, name: str, body: bytes) -> T:
        """The value of a body; raises `StoreError`."""
        self._check_size(name, body)
        try:
            return self.read(name, body)
        except StoreError as err:
            raise StoreError(f"{self.name} {name!r}: {err}") from None

    def _check_size(self, name: str, body: bytes) -> None:
        if len(body) > self.limit:
            msg = f"{self.name} {name!r} has {len(body)} bytes, and may have {self.limit}"
            raise StoreError(msg)


MAP: Kind[MapGrid2D] = Kind("map", GRID, _LARGE, write_map, read_map)
LOCATION: Kind[Map2DLocation] = Kind(
    "location", JSON, _SMALL, *places.json_codec(places.location_json, places.json_location)
)
AREA: Kind[Map2DArea] = Kind("area", JSON, _SMALL, *places.json_codec(places.area_json, places.json_area))
PATH: Kind[Map2DPath] = Kind("path", JSON, _SMALL, *places.json_codec(places.path_json, places.json_path))
OBJECT: Kind[Map2DObject] = Kind("object", JSON, _SMALL, *places.json_codec(places.object_json, places.json_object))
LINK: Kind[MapLink] = Kind("link", JSON, _SMALL, *places.json_codec(places.link_json, places.json_link))
BEHAVIOUR: Kind[AreaBehaviour] = Kind(
    "behaviour", JSON, _SMALL, *places.json_codec(places.behaviour_json, places.json_behaviour)
)
"""What an area asks of robots, under the area's name."""
CURRENT: Kind[str] = Kind("current", JSON, _SMALL, *places.json_codec(places.current_json, places.json_current))
"""Which one is current, of what there may be one only: under ``map`` a map's name."""

KINDS: dict[str, Kind[Any]] = {
    kind.name: kind for kind in (MAP, LOCATION, AREA, BEHAVIOUR, PATH, OBJECT, LINK, CURRENT)
}

"""The commands of ``/mapper3D/rpc``, and the files of maps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.stores.entry import StoreError
from bridge.stores.kinds import MAP, MAP3D
from bridge.stores.store import Store, Write
from navigation.map2d_server.files import MapsFolder
from navigation.mapper3d.space import Space
from navigation.yarp import Commands
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.octomap import Octomap
from yarp_compat.wire.errors import WireError

HELP = (
    "help: these lines",
    "start: take clouds",
    "stop: take none",
    "clear: begin a new map",
    "save_to_file FILE: a name in the maps folder, .bt for free and occupied alone or .ot for probabilities",
    "load_from_file FILE: go on with a map of the maps folder",
    "save_to_mapserver: the map and its layer into the store, for map servers and planners",
    "load_from_mapserver NAME: go on with a map of the store",
)
_SUFFIXES = (".bt", ".ot")


class SpaceCommands(Commands):
    """Answers commands of the RPC port. Called on the module's thread.

    Attributes:
        mapping: whether clouds are taken.
    """

    def __init__(
        self,
        space: Space,
        layer: Callable[[], MapGrid2D],
        store: Callable[[], Store],
        folder: MapsFolder,
        name: str,
        *,
        mapping: bool,
    ) -> None:
        self._space, self._layer, self._store, self._folder, self._name = space, layer, store, folder, name
        self.mapping = mapping
        super().__init__(HELP, {
            "start": lambda _rest: self.run(mapping=True),
            "stop": lambda _rest: self.run(mapping=False),
            "clear": self._clear,
            "save_to_file": self._save_file,
            "load_from_file": self._load_file,
            "save_to_mapserver": lambda _rest: self.save(),
            "load_from_mapserver": lambda rest: self.load(_word(rest)),
        })  # fmt: skip

    def answer(self, values: list[Any]) -> list[Any]:
        """As `Commands.answer`."""
        try:
            return super().answer(values)
        except (OSError, StoreError, WireError) as err:
            raise ValueError(f"{values[0]}: {err}") from None

    def run(self, *, mapping: bool) -> str:
        """Map, or do not."""
        self.mapping = mapping
        return "Mapping." if mapping else "Not mapping; 'start' goes on."

    def save(self) -> str:
        """Put map and layer into the store; what was done. Raises `StoreError`, and `ValueError` without a layer."""
        grid, octomap = self._layer(), Octomap.of(self._space.tree())
        self._store().write([Write(MAP, grid.name, grid), Write(MAP3D, self._name, octomap)])
        return f"3D map {self._name} and layer {grid.name} saved into the store."

    def load(self, name: str) -> str:
        """Go on with an octomap of the store; what was done. Raises `StoreError`, `ValueError`, `WireError`."""
        store = self._store()
        found = store.get(MAP3D, name)
        if not isinstance(found, Octomap):
            what = f"the 3D map {name!r} is a cloud" if found is not None else f"there is no 3D map {name!r}"
            raise StoreError(f"{what}; 3D maps in the store: {', '.join(store.names(MAP3D)) or 'none'}")
        self._space.load(found.tree())
        return f"3D map {name} loaded; mapping goes on on it."

    def _clear(self, _rest: list[Any]) -> str:
        self._space.clear()
        return "A new map is begun."

    def _save_file(self, rest: list[Any]) -> str:
        file = self._folder.new(_word(rest), *_SUFFIXES)
        Octomap.of(self._space.tree(), binary=file.suffix == ".bt").save(file)
        return f"Map saved as {file.name}."

    def _load_file(self, rest: list[Any]) -> str:
        file = self._folder.existing(_word(rest), *_SUFFIXES)
        self._space.load(Octomap.load(file).tree())
        return f"Map {file.name} loaded; mapping goes on on it."


def _word(rest: list[Any]) -> str:
    if len(rest) != 1 or not isinstance(rest[0], str):
        raise ValueError(f"one word is needed, a name; not {' '.join(map(str, rest)) or 'nothing'}")
    return rest[0]

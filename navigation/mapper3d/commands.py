"""The commands of ``/mapper3D/rpc``, and map files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from typing_extensions import override

from bridge.stores.entry import StoreError
from bridge.stores.kinds import MAP, MAP3D
from bridge.stores.store import Store, Write
from navigation.map2d_server.files import MapsFolder
from navigation.mapper3d.space import Space
from navigation.mapping_commands import MappingCommands
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.octomap import Octomap

HELP = (
    "help: list the commands",
    "start: start mapping",
    "stop: stop mapping",
    "clear: start a new map",
    "save_to_file FILE: save the map in the maps folder, as .bt for free and occupied only, or .ot for probabilities",
    "load_from_file FILE: load a map from the maps folder and continue it",
    "save_to_mapserver: save the map and its layer in the store, for map servers and planners",
    "load_from_mapserver NAME: load a map from the store and continue it",
)
_SUFFIXES = (".bt", ".ot")


class SpaceCommands(MappingCommands):
    """Answers commands of the RPC port. Used only on the module's thread.

    Attributes:
        mapping: whether clouds are used.
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
            "start": lambda _arguments: self.run(mapping=True),
            "stop": lambda _arguments: self.run(mapping=False),
            "clear": self._clear,
            "save_to_file": self._save_file,
            "load_from_file": self._load_file,
            "save_to_mapserver": lambda _arguments: self.save(),
            "load_from_mapserver": lambda arguments: self.load(_name(arguments)),
        })  # fmt: skip

    def run(self, *, mapping: bool) -> str:
        """Start or stop mapping; return a text for people."""
        self.mapping = mapping
        return "Mapping." if mapping else "Stopped; 'start' continues."

    @override
    def save(self) -> str:
        """Save map and layer in the store; return a text for people.

        Raises `StoreError`, and `ValueError` if the robot's pose is unknown.
        """
        grid, octomap = self._layer(), Octomap.of(self._space.tree())
        self._store().write([Write(MAP, grid.name, grid), Write(MAP3D, self._name, octomap)])
        return f"3D map {self._name} and layer {grid.name} saved into the store."

    def load(self, name: str) -> str:
        """Continue an octomap of the store; return a text. Raises `StoreError`, `ValueError`, `WireError`."""
        store = self._store()
        octomap = store.get(MAP3D, name)
        if not isinstance(octomap, Octomap):
            problem = f"the 3D map {name!r} is a cloud" if octomap is not None else f"no 3D map {name!r}"
            raise StoreError(f"{problem}; 3D maps in the store: {', '.join(store.names(MAP3D)) or 'none'}")
        self._space.load(octomap.tree())
        return f"3D map {name} loaded; mapping continues on it."

    def _clear(self, _arguments: list[Any]) -> str:
        self._space.clear()
        return "Started a new map."

    def _save_file(self, arguments: list[Any]) -> str:
        file = self._folder.new(_name(arguments), *_SUFFIXES)
        Octomap.of(self._space.tree(), binary=file.suffix == ".bt").save(file)
        return f"Map saved as {file.name}."

    def _load_file(self, arguments: list[Any]) -> str:
        file = self._folder.existing(_name(arguments), *_SUFFIXES)
        self._space.load(Octomap.load(file).tree())
        return f"Map {file.name} loaded; mapping continues on it."


def _name(arguments: list[Any]) -> str:
    if len(arguments) != 1 or not isinstance(arguments[0], str):
        raise ValueError(f"the command needs one name, not {' '.join(map(str, arguments)) or 'none'}")
    return arguments[0]

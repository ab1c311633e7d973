"""The commands of ``/mapper3D/rpc``, and the files of maps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.stores.entry import StoreError
from bridge.stores.kinds import MAP
from bridge.stores.store import Store
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
    "save_to_mapserver: the layer into the store, for map servers and planners",
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
        *,
        mapping: bool,
    ) -> None:
        self._space, self._layer, self._store, self._folder = space, layer, store, folder
        self.mapping = mapping
        super().__init__(HELP, {
            "start": lambda _rest: self.run(mapping=True),
            "stop": lambda _rest: self.run(mapping=False),
            "clear": self._clear,
            "save_to_file": self._save_file,
            "load_from_file": self._load_file,
            "save_to_mapserver": lambda _rest: self.save(),
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
        """Put the layer into the store; what was done. Raises `StoreError`, and `ValueError` where there is none."""
        grid = self._layer()
        self._store().put(MAP, grid.name, grid)
        return f"Layer {grid.name} saved into the store."

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
        raise ValueError(f"one word is needed: FILE; not {' '.join(map(str, rest)) or 'nothing'}")
    return rest[0]

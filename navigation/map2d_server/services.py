"""The services of ROS's map servers, YARP's IMap2D, and commands for ``yarp rpc``."""

# ruff: noqa: N815 - YARP's names, documented in its interface

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from typing_extensions import override

from bridge.hub.endpoints.calls import CallError
from bridge.modules.host import ModuleNode
from bridge.modules.services import Answer
from bridge.stores.entry import StoreError
from bridge.stores.kinds import AREA, LOCATION, MAP, OBJECT, PATH, ValueKind
from bridge.stores.store import Store
from navigation.map2d_server.files import MapFiles
from navigation.map2d_server.publishers import MAP_TOPIC, AllMaps, CurrentMap
from navigation.maps.grid import turned
from navigation.messages import Message
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnValue
from yarp_compat.wire.values import Vocab

T = TypeVar("T")


def _methods(kind: ValueKind[Any]) -> tuple[Any, ...]:
    """Return the methods that are the same for each kind of place."""

    def store(self: MapAnswers, name: str, value: Any) -> ReturnValue:
        return self._store_value(kind, name, value)

    def get(self: MapAnswers, name: str) -> tuple[ReturnValue, Any]:
        return self._get(kind, name)

    def names(self: MapAnswers) -> tuple[ReturnValue, list[str]]:
        return self._names(kind)

    def get_all(self: MapAnswers) -> tuple[ReturnValue, list[Any]]:
        return self._all(kind)

    def rename(self: MapAnswers, old: str, new: str) -> ReturnValue:
        return self._change(self._store.rename, kind, old, new)

    def delete(self: MapAnswers, name: str) -> ReturnValue:
        return self._delete(kind, name)

    def clear(self: MapAnswers) -> ReturnValue:
        return self._change(self._store.clear, kind)

    return store, get, names, get_all, rename, delete, clear


class MapAnswers(IMap2DMsgs):
    """Serves IMap2D on connections' threads; stored and loaded values replace those with the same name."""

    def __init__(self, store: Store, files: MapFiles, on_refusal: Callable[[str], None]) -> None:
        super().__init__()
        self._store, self._files, self._on_refusal = store, files, on_refusal
        self._compressed = True

    # -- maps ---------------------------------------------------------------------------------------------------------

    @override
    def clear_all_maps_RPC(self) -> ReturnValue:
        return self._change(self._store.clear, MAP)

    @override
    def store_map_RPC(self, themap: MapGrid2D) -> ReturnValue:
        return self._store_value(MAP, themap.name, themap)

    @override
    def get_map_RPC(self, map_name: str) -> tuple[ReturnValue, MapGrid2D]:
        outcome, grid = self._get(MAP, map_name)
        grid.enable_map_compression_over_network(self._compressed)
        return outcome, grid

    @override
    def get_map_names_RPC(self) -> tuple[ReturnValue, list[str]]:
        return self._names(MAP)

    @override
    def remove_map_RPC(self, map_name: str) -> ReturnValue:
        return self._delete(MAP, map_name)

    @override
    def clear_all_maps_temporary_flags_RPC(self) -> ReturnValue:
        for name in self._names(MAP)[1]:
            self.clear_map_temporary_flags_RPC(name)
        return OK

    @override
    def clear_map_temporary_flags_RPC(self, map_name: str) -> ReturnValue:
        with self._store.replica.locked():  # so that flags painted meanwhile are not lost
            _, grid = self._get(MAP, map_name)
            grid.clearMapTemporaryFlags()
            return self._store_value(MAP, map_name, grid)

    @override
    def enable_maps_compression_RPC(self, enable_compression: bool) -> ReturnValue:
        self._compressed = enable_compression
        return OK

    # -- objects, locations, areas and paths ---------------------------------------------------------------------------

    store_object_RPC, get_object_RPC, get_objects_list_RPC, get_all_objects_RPC, *_objects = _methods(OBJECT)
    rename_object_RPC, delete_object_RPC, clear_all_objects_RPC = _objects
    store_location_RPC, get_location_RPC, get_locations_list_RPC, get_all_locations_RPC, *_locations = _methods(
        LOCATION
    )
    rename_location_RPC, delete_location_RPC, clear_all_locations_RPC = _locations
    store_area_RPC, get_area_RPC, get_areas_list_RPC, get_all_areas_RPC, *_areas = _methods(AREA)
    rename_area_RPC, delete_area_RPC, clear_all_areas_RPC = _areas
    store_path_RPC, get_path_RPC, get_paths_list_RPC, get_all_paths_RPC, *_paths = _methods(PATH)
    rename_path_RPC, delete_path_RPC, clear_all_paths_RPC = _paths

    # -- files --------------------------------------------------------------------------------------------------------

    @override
    def save_maps_collection_RPC(self, maps_collection_file: str) -> ReturnValue:
        return self._change(self._files.save_collection, maps_collection_file)

    @override
    def load_maps_collection_RPC(self, maps_collection_file: str) -> ReturnValue:
        return self._change(self._files.load_collection, maps_collection_file)

    @override
    def save_locations_and_extras_RPC(self, locations_collection_file: str) -> ReturnValue:
        return self._change(self._files.save_places, locations_collection_file)

    @override
    def load_locations_and_extras_RPC(self, locations_collection_file: str) -> ReturnValue:
        return self._change(self._files.load_places, locations_collection_file)

    @override
    def save_map_to_disk_RPC(self, map_name: str, file_name: str) -> ReturnValue:
        return self._change(self._files.save_map, map_name, file_name)

    @override
    def load_map_from_disk_RPC(self, file_name: str) -> ReturnValue:
        return self._change(self._files.load_map, file_name)

    @override
    def reload_maps_collection_RPC(self) -> ReturnValue:
        return self._change(self._files.reload_collection)

    @override
    def reload_locations_and_extras_RPC(self) -> ReturnValue:
        return self._change(self._files.reload_places)

    # -- shared parts ------------------------------------------------------------------------------------------------

    def _get(self, kind: ValueKind[T], name: str) -> tuple[ReturnValue, T]:
        with self._reporting_errors():
            value = self._store.get(kind, name)
        if value is None:
            raise CallFailed(reason=f"no {kind.name} {name!r}")
        return OK, value

    def _names(self, kind: ValueKind[Any]) -> tuple[ReturnValue, list[str]]:
        with self._reporting_errors():
            return OK, self._store.names(kind)

    def _all(self, kind: ValueKind[T]) -> tuple[ReturnValue, list[T]]:
        with self._reporting_errors():
            values = self._store.all(kind)
        return OK, [values[name] for name in sorted(values)]

    def _store_value(self, kind: ValueKind[T], name: str, value: T) -> ReturnValue:
        return self._change(self._store.put, kind, name, value)

    def _delete(self, kind: ValueKind[Any], name: str) -> ReturnValue:
        with self._reporting_errors():
            if not self._store.delete(kind, name):
                raise CallFailed(reason=f"no {kind.name} {name!r}")
        return OK

    def _change(self, action: Callable[..., Any], *arguments: Any) -> ReturnValue:
        with self._reporting_errors():
            action(*arguments)
        return OK

    @contextmanager
    def _reporting_errors(self) -> Iterator[None]:
        """Report errors of the store and of files, and fail the call."""
        try:
            yield
        except (StoreError, ValueError, OSError) as error:
            self._on_refusal(str(error))
            raise CallFailed(reason=str(error)) from error


_HELP = ["current: the name of the current map", "use NAME: select a map of the store", "maps: all names"]


class MapCommands:
    """Answers commands in Bottles; an error is answered as ``[fail]`` with its text."""

    def __init__(self, store: Store, current: CurrentMap) -> None:
        self._store, self._current = store, current

    def answer(self, values: list[Any]) -> list[Any]:
        """Answer a command."""
        match [str(value) for value in values]:
            case ["current"]:
                return [self._current.choose()]
            case ["maps"]:
                return list(self._store.names(MAP))
            case ["use", name]:
                self._use(name)
                return [Vocab("ok")]
            case _:
                return [Vocab("many"), *_HELP]

    def _use(self, name: str) -> None:
        try:
            self._store.use_map(name)
        except StoreError as error:
            raise ValueError(str(error)) from error


_SUCCESS, _NOT_THERE, _INVALID = 0, 1, 2
"""``result`` of LoadMap (`nav2_msgs/srv/LoadMap.srv`); ROS 1 has the same values."""


class MapServices:
    """Serves and changes the current map; clients load from and save to ``files``."""

    def __init__(
        self,
        node: ModuleNode,
        store: Store,
        files: MapFiles,
        current: CurrentMap,
        maps: AllMaps,
        on_refusal: Callable[[str], None],
    ) -> None:
        self._store, self._files, self._current, self._maps = store, files, current, maps
        self._on_refusal = on_refusal
        node.server("/static_map", "nav_msgs/srv/GetMap", self._static_map)
        node.server("/map_server/map", "nav_msgs/srv/GetMap", self._get)
        node.server("/change_map", "nav_msgs/srv/LoadMap", self._load)
        node.server("/map_server/load_map", "nav2_msgs/srv/LoadMap", self._load)
        node.server("/map_saver/save_map", "nav2_msgs/srv/SaveMap", self._save)

    def _static_map(self, _request: Message, answer: Answer) -> None:
        message = self._current.message()
        answer(CallError("no current map; select one of the store") if message is None else {"map": message})

    def _get(self, _request: Message, answer: Answer) -> None:
        # a ROS 2 client would wait forever for the answer to a failed call
        message = self._current.message()
        answer({} if message is None else {"map": message})

    def _load(self, request: Message, answer: Answer) -> None:
        try:
            grid = self._select(str(request["map_url"]))
        except FileNotFoundError as error:
            self._on_refusal(f"LoadMap: {error}")
            answer({"result": _NOT_THERE})
        except (StoreError, ValueError, OSError) as error:
            self._on_refusal(f"LoadMap: {error}")
            answer({"result": _INVALID})
        else:
            answer({"map": self._current.message_of(grid), "result": _SUCCESS})

    def _select(self, wanted: str) -> MapGrid2D:
        """Select the map that a client requests, from the store or a file; return it aligned with the axes."""
        stored = self._store.get(MAP, wanted) if wanted in self._store.names(MAP) else None
        grid = self._files.load_map(wanted) if stored is None else stored
        self._store.use_map(grid.name)
        return turned(grid)

    def _save(self, request: Message, answer: Answer) -> None:
        try:
            topic = f"/{str(request['map_topic']).lstrip('/') or 'map'}"
            self._files.save_map(
                self._of_topic(topic),
                str(request["map_url"]),
                image=str(request["image_format"]),
                mode=str(request["map_mode"]),
                thresholds=(float(request["free_thresh"]), float(request["occupied_thresh"])),
            )
        except (StoreError, ValueError, OSError) as error:
            self._on_refusal(f"SaveMap: {error}")
            answer({"result": False})
        else:
            answer({"result": True})

    def _of_topic(self, topic: str) -> str:
        names = {other: name for name, other in self._maps.topics.items()} | {MAP_TOPIC: self._current.name}
        if not names.get(topic):
            raise ValueError(f"{topic} is not a map of the store; its maps are {', '.join(sorted(names))}")
        return names[topic]

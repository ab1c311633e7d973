"""What YARP's map clients ask, answered out of the store."""

# ruff: noqa: D102, N802 - the interface says what each does, and its names are YARP's

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from bridge.stores.errors import StoreError
from bridge.stores.kinds import AREA, LOCATION, MAP, OBJECT, PATH, Kind
from bridge.stores.store import Store
from navigation.map2d_server.files import MapFiles
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnValue

T = TypeVar("T")


class MapAnswers(IMap2DMsgs):
    """Serves IMap2D. Its methods run on the threads of the connections, several at a time.

    Other than YARP's map2DStorage, a store or load takes the place of what has the name, every time.

    Args:
        store: what is served.
        files: what clients may have written and read.
        told: hears why a call was refused.
    """

    def __init__(self, store: Store, files: MapFiles, told: Callable[[str], None]) -> None:
        super().__init__()
        self._store, self._files, self._told = store, files, told
        self._compressed = True

    # -- maps ---------------------------------------------------------------------------------------------------------

    def clear_all_maps_RPC(self) -> ReturnValue:
        return self._clear(MAP)

    def store_map_RPC(self, themap: MapGrid2D) -> ReturnValue:
        return self._put(MAP, themap.name, themap)

    def get_map_RPC(self, map_name: str) -> tuple[ReturnValue, MapGrid2D]:
        outcome, found = self._get(MAP, map_name)
        found.enable_map_compression_over_network(self._compressed)
        return outcome, found

    def get_map_names_RPC(self) -> tuple[ReturnValue, list[str]]:
        return self._names(MAP)

    def remove_map_RPC(self, map_name: str) -> ReturnValue:
        return self._delete(MAP, map_name)

    def clear_all_maps_temporary_flags_RPC(self) -> ReturnValue:
        for name in self._names(MAP)[1]:
            self.clear_map_temporary_flags_RPC(name)
        return OK

    def clear_map_temporary_flags_RPC(self, map_name: str) -> ReturnValue:
        _, found = self._get(MAP, map_name)
        found.clearMapTemporaryFlags()
        return self._put(MAP, map_name, found)

    def enable_maps_compression_RPC(self, enable_compression: bool) -> ReturnValue:
        self._compressed = enable_compression
        return OK

    # -- objects ------------------------------------------------------------------------------------------------------

    def store_object_RPC(self, object_name: str, loc: Map2DObject) -> ReturnValue:
        return self._put(OBJECT, object_name, loc)

    def get_object_RPC(self, object_name: str) -> tuple[ReturnValue, Map2DObject]:
        return self._get(OBJECT, object_name)

    def get_objects_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        return self._names(OBJECT)

    def get_all_objects_RPC(self) -> tuple[ReturnValue, list[Map2DObject]]:
        return self._all(OBJECT)

    def rename_object_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        return self._rename(OBJECT, original_name, new_name)

    def delete_object_RPC(self, object_name: str) -> ReturnValue:
        return self._delete(OBJECT, object_name)

    def clear_all_objects_RPC(self) -> ReturnValue:
        return self._clear(OBJECT)

    # -- locations ----------------------------------------------------------------------------------------------------

    def store_location_RPC(self, location_name: str, loc: Map2DLocation) -> ReturnValue:
        return self._put(LOCATION, location_name, loc)

    def get_location_RPC(self, location_name: str) -> tuple[ReturnValue, Map2DLocation]:
        return self._get(LOCATION, location_name)

    def get_locations_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        return self._names(LOCATION)

    def get_all_locations_RPC(self) -> tuple[ReturnValue, list[Map2DLocation]]:
        return self._all(LOCATION)

    def rename_location_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        return self._rename(LOCATION, original_name, new_name)

    def delete_location_RPC(self, location_name: str) -> ReturnValue:
        return self._delete(LOCATION, location_name)

    def clear_all_locations_RPC(self) -> ReturnValue:
        return self._clear(LOCATION)

    # -- areas --------------------------------------------------------------------------------------------------------

    def store_area_RPC(self, area_name: str, area: Map2DArea) -> ReturnValue:
        return self._put(AREA, area_name, area)

    def get_area_RPC(self, area_name: str) -> tuple[ReturnValue, Map2DArea]:
        return self._get(AREA, area_name)

    def get_areas_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        return self._names(AREA)

    def get_all_areas_RPC(self) -> tuple[ReturnValue, list[Map2DArea]]:
        return self._all(AREA)

    def rename_area_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        return self._rename(AREA, original_name, new_name)

    def delete_area_RPC(self, area_name: str) -> ReturnValue:
        return self._delete(AREA, area_name)

    def clear_all_areas_RPC(self) -> ReturnValue:
        return self._clear(AREA)

    # -- paths --------------------------------------------------------------------------------------------------------

    def store_path_RPC(self, path_name: str, path: Map2DPath) -> ReturnValue:
        return self._put(PATH, path_name, path)

    def get_path_RPC(self, path_name: str) -> tuple[ReturnValue, Map2DPath]:
        return self._get(PATH, path_name)

    def get_paths_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        return self._names(PATH)

    def get_all_paths_RPC(self) -> tuple[ReturnValue, list[Map2DPath]]:
        return self._all(PATH)

    def rename_path_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        return self._rename(PATH, original_name, new_name)

    def delete_path_RPC(self, path_name: str) -> ReturnValue:
        return self._delete(PATH, path_name)

    def clear_all_paths_RPC(self) -> ReturnValue:
        return self._clear(PATH)

    # -- files --------------------------------------------------------------------------------------------------------

    def save_maps_collection_RPC(self, maps_collection_file: str) -> ReturnValue:
        return self._filed(self._files.save_collection, maps_collection_file)

    def load_maps_collection_RPC(self, maps_collection_file: str) -> ReturnValue:
        return self._filed(self._files.load_collection, maps_collection_file)

    def save_locations_and_extras_RPC(self, locations_collection_file: str) -> ReturnValue:
        return self._filed(self._files.save_places, locations_collection_file)

    def load_locations_and_extras_RPC(self, locations_collection_file: str) -> ReturnValue:
        return self._filed(self._files.load_places, locations_collection_file)

    def save_map_to_disk_RPC(self, map_name: str, file_name: str) -> ReturnValue:
        return self._filed(self._files.save_map, map_name, file_name)

    def load_map_from_disk_RPC(self, file_name: str) -> ReturnValue:
        return self._filed(self._files.load_map, file_name)

    def reload_maps_collection_RPC(self) -> ReturnValue:
        return self._filed(self._files.reload_collection)

    def reload_locations_and_extras_RPC(self) -> ReturnValue:
        return self._filed(self._files.reload_places)

    # -- all of these -------------------------------------------------------------------------------------------------

    def _get(self, kind: Kind[T], name: str) -> tuple[ReturnValue, T]:
        with self._refusing():
            found = self._store.get(kind, name)
        if found is None:
            raise CallFailed(reason=f"there is no {kind.name} {name!r}")
        return OK, found

    def _names(self, kind: Kind[Any]) -> tuple[ReturnValue, list[str]]:
        with self._refusing():
            return OK, self._store.names(kind)

    def _all(self, kind: Kind[T]) -> tuple[ReturnValue, list[T]]:
        with self._refusing():
            found = self._store.all(kind)
        return OK, [found[name] for name in sorted(found)]

    def _put(self, kind: Kind[T], name: str, value: T) -> ReturnValue:
        with self._refusing():
            self._store.put(kind, name, value)
        return OK

    def _rename(self, kind: Kind[Any], old: str, new: str) -> ReturnValue:
        with self._refusing():
            self._store.rename(kind, old, new)
        return OK

    def _delete(self, kind: Kind[Any], name: str) -> ReturnValue:
        with self._refusing():
            if not self._store.delete(kind, name):
                raise CallFailed(reason=f"there is no {kind.name} {name!r}")
        return OK

    def _clear(self, kind: Kind[Any]) -> ReturnValue:
        with self._refusing():
            self._store.clear(kind)
        return OK

    def _filed(self, action: Callable[..., Any], *arguments: str) -> ReturnValue:
        with self._refusing():
            action(*arguments)
        return OK

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """What the store and the files refuse is the call's failure, and told."""
        try:
            yield
        except (StoreError, ValueError, OSError) as error:
            self._told(str(error))
            raise CallFailed(reason=str(error)) from error

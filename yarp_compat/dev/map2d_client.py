"""A client of a map server: YARP's ``IMap2D``, and the maps and places as mappings.

with Map2DClient("/map2D_nws_yarp/rpc") as maps:
    maps.locations["kitchen"] = Map2DLocation("office", 1.0, 2.0, 90.0)
    office = maps.maps["office"]
    maps.getLocation("kitchen", location)      # as in C++: true if it succeeded
"""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import Any, Generic, TypeVar, Unpack, cast

from yarp_compat.dev.client import ClientOptions, ServiceClient
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode, ReturnValue, filled, listed, outcome_of
from yarp_compat.overriding import override

T = TypeVar("T")


class _View(MutableMapping[str, T], Generic[T]):
    """The items of one kind by name, through the server's methods for that kind."""

    def __init__(self, remote: IMap2DMsgs, kind: str, names: str, delete: str) -> None:
        self._remote, self._kind, self._names, self._delete = remote, kind, names, delete

    @override
    def __getitem__(self, name: str) -> T:
        return cast("T", self._call(f"get_{self._kind}", name, key=name))

    @override
    def __setitem__(self, name: str, value: T) -> None:
        self._call(f"store_{self._kind}", name, value)

    @override
    def __delitem__(self, name: str) -> None:
        self._call(self._delete, name, key=name)

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self._call(self._names))

    @override
    def __len__(self) -> int:
        return sum(1 for _ in self)

    @override
    def clear(self) -> None:
        self._call(f"clear_all_{self._kind}s")

    def _call(self, method: str, *arguments: Any, key: str | None = None) -> Any:
        """Call a method and return its result; raises `KeyError` if a ``key`` is given and the method fails for it."""
        returned = getattr(self._remote, f"{method}_RPC")(*arguments)
        outcome, *results = (returned,) if isinstance(returned, ReturnValue) else returned
        if key is not None and outcome.code is ReturnCode.METHOD_FAILED:
            raise KeyError(key)
        succeeded(outcome)
        return results[0] if results else None


class Maps(_View[MapGrid2D]):
    """Maps by name: ``maps["office"]``. Iterating takes one request for all names; each map takes its own request.

    All methods raise `CallFailed` if the server refuses, `ConnectionError` or `TimeoutError` if it is unreachable;
    those for a single map raise `KeyError` if the map is missing.
    """

    def __init__(self, remote: IMap2DMsgs) -> None:
        super().__init__(remote, "map", "get_map_names", "remove_map")

    @override
    def __setitem__(self, name: str, value: MapGrid2D) -> None:
        """Store a map; raises `ValueError` unless ``name`` is the map's own name."""
        if value.name != name:
            raise ValueError(f"the map's own name is {value.name!r}, not {name!r}")
        self._call("store_map", value)

    def clear_temporary_flags(self, name: str | None = None) -> None:
        """Remove the temporary flags of one map, or of all."""
        if name is None:
            self._call("clear_all_maps_temporary_flags")
        else:
            self._call("clear_map_temporary_flags", name, key=name)

    def compress(self, enable: bool) -> None:
        """Switch the compression of maps on the wire on or off."""
        self._call("enable_maps_compression", enable)

    def save(self, name: str, file_name: str) -> None:
        """Let the server write a map to a file on its machine."""
        self._call("save_map_to_disk", name, file_name)

    def load(self, file_name: str) -> None:
        """Let the server read a map from a file on its machine."""
        self._call("load_map_from_disk", file_name)

    def save_collection(self, file_name: str) -> None:
        """Let the server write all maps and their list."""
        self._call("save_maps_collection", file_name)

    def load_collection(self, file_name: str) -> None:
        """Let the server read the maps of a list that `save_collection` wrote."""
        self._call("load_maps_collection", file_name)

    def reload(self) -> None:
        """Let the server read its initial collection again."""
        self._call("reload_maps_collection")


class PlacesView(_View[T], Generic[T]):
    """Places of one kind (``object``, ``location``, ``area`` or ``path``) by name: ``locations["kitchen"]``."""

    def __init__(self, remote: IMap2DMsgs, kind: str) -> None:
        super().__init__(remote, kind, f"get_{kind}s_list", f"delete_{kind}")

    def everything(self) -> list[T]:
        """Return all places in one call, sorted by name."""
        return cast("list[T]", self._call(f"get_all_{self._kind}s"))

    def rename(self, old: str, new: str) -> None:
        """Rename a place; raises `KeyError` if the old name is missing or the new one exists."""
        self._call(f"rename_{self._kind}", old, new, key=old)


def succeeded(outcome: ReturnValue) -> None:
    """Raise `CallFailed` if a call failed."""
    if not outcome:
        raise CallFailed(outcome.code, "the server refused the call; see its log")


class IMap2D:
    """The interface under YARP's names (`yarp/dev/IMap2D.h`). Results that C++ returns by reference are filled in.

    Nothing raises: a failed call returns a false outcome. Lists of results are cleared and filled; without a list, the
    results are returned, as in the bindings: ``for name in maps.getLocationsList()``.
    """

    def __init__(self, remote: IMap2DMsgs) -> None:
        self._remote = remote

    clearAllMaps = outcome_of(IMap2DMsgs.clear_all_maps_RPC)
    store_map = outcome_of(IMap2DMsgs.store_map_RPC)
    get_map = filled(IMap2DMsgs.get_map_RPC)
    get_map_names = listed(IMap2DMsgs.get_map_names_RPC)
    remove_map = outcome_of(IMap2DMsgs.remove_map_RPC)
    clearAllMapsTemporaryFlags = outcome_of(IMap2DMsgs.clear_all_maps_temporary_flags_RPC)
    clearMapTemporaryFlags = outcome_of(IMap2DMsgs.clear_map_temporary_flags_RPC)
    enableMapsCompression = outcome_of(IMap2DMsgs.enable_maps_compression_RPC)
    storeObject = outcome_of(IMap2DMsgs.store_object_RPC)
    getObject = filled(IMap2DMsgs.get_object_RPC)
    getObjectsList = listed(IMap2DMsgs.get_objects_list_RPC)
    getAllObjects = listed(IMap2DMsgs.get_all_objects_RPC)
    renameObject = outcome_of(IMap2DMsgs.rename_object_RPC)
    deleteObject = outcome_of(IMap2DMsgs.delete_object_RPC)
    clearAllObjects = outcome_of(IMap2DMsgs.clear_all_objects_RPC)
    storeLocation = outcome_of(IMap2DMsgs.store_location_RPC)
    getLocation = filled(IMap2DMsgs.get_location_RPC)
    getLocationsList = listed(IMap2DMsgs.get_locations_list_RPC)
    getAllLocations = listed(IMap2DMsgs.get_all_locations_RPC)
    renameLocation = outcome_of(IMap2DMsgs.rename_location_RPC)
    deleteLocation = outcome_of(IMap2DMsgs.delete_location_RPC)
    clearAllLocations = outcome_of(IMap2DMsgs.clear_all_locations_RPC)
    storeArea = outcome_of(IMap2DMsgs.store_area_RPC)
    getArea = filled(IMap2DMsgs.get_area_RPC)
    getAreasList = listed(IMap2DMsgs.get_areas_list_RPC)
    getAllAreas = listed(IMap2DMsgs.get_all_areas_RPC)
    renameArea = outcome_of(IMap2DMsgs.rename_area_RPC)
    deleteArea = outcome_of(IMap2DMsgs.delete_area_RPC)
    clearAllAreas = outcome_of(IMap2DMsgs.clear_all_areas_RPC)
    storePath = outcome_of(IMap2DMsgs.store_path_RPC)
    getPath = filled(IMap2DMsgs.get_path_RPC)
    getPathsList = listed(IMap2DMsgs.get_paths_list_RPC)
    getAllPaths = listed(IMap2DMsgs.get_all_paths_RPC)
    renamePath = outcome_of(IMap2DMsgs.rename_path_RPC)
    deletePath = outcome_of(IMap2DMsgs.delete_path_RPC)
    clearAllPaths = outcome_of(IMap2DMsgs.clear_all_paths_RPC)
    saveMapToDisk = outcome_of(IMap2DMsgs.save_map_to_disk_RPC)
    loadMapFromDisk = outcome_of(IMap2DMsgs.load_map_from_disk_RPC)
    saveMapsCollection = outcome_of(IMap2DMsgs.save_maps_collection_RPC)
    loadMapsCollection = outcome_of(IMap2DMsgs.load_maps_collection_RPC)
    saveLocationsAndExtras = outcome_of(IMap2DMsgs.save_locations_and_extras_RPC)
    loadLocationsAndExtras = outcome_of(IMap2DMsgs.load_locations_and_extras_RPC)
    reloadMapsCollection = outcome_of(IMap2DMsgs.reload_maps_collection_RPC)
    reloadLocationsAndExtras = outcome_of(IMap2DMsgs.reload_locations_and_extras_RPC)


class Map2DClient(ServiceClient[IMap2DMsgs], IMap2D):
    """A client of a map server, with its maps and places as mappings; for the arguments, see `ServiceClient`."""

    def __init__(self, server: str = "/map2D_nws_yarp/rpc", name: str = "", **options: Unpack[ClientOptions]) -> None:
        ServiceClient.__init__(self, IMap2DMsgs, server, name, **options)
        IMap2D.__init__(self, self.remote)
        self.maps = Maps(self.remote)
        self.objects: PlacesView[Map2DObject] = PlacesView(self.remote, "object")
        self.locations: PlacesView[Map2DLocation] = PlacesView(self.remote, "location")
        self.areas: PlacesView[Map2DArea] = PlacesView(self.remote, "area")
        self.paths: PlacesView[Map2DPath] = PlacesView(self.remote, "path")

    def save_places(self, file_name: str) -> None:
        """Let the server write all locations, objects, areas and paths; raises `CallFailed` if it refuses."""
        succeeded(self.remote.save_locations_and_extras_RPC(file_name))

    def load_places(self, file_name: str) -> None:
        """Let the server read a file that `save_places` wrote; raises `CallFailed` if it refuses."""
        succeeded(self.remote.load_locations_and_extras_RPC(file_name))

    def reload_places(self) -> None:
        """Let the server read its initial file again; raises `CallFailed` if it refuses."""
        succeeded(self.remote.reload_locations_and_extras_RPC())

"""``IMap2D`` as YARP users know it, and the Python way: a server's maps and places as mappings.

with Map2DClient("/map2D_nws_yarp/rpc") as maps:
    maps.locations["kitchen"] = Map2DLocation("office", 1.0, 2.0, 90.0)
    office = maps.maps["office"]
    maps.getLocation("kitchen", location)      # as in C++: true where it succeeded
"""

from __future__ import annotations

from yarp_compat.dev.client import PATIENCE, ServiceClient
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.map2d_views import Maps, Places, succeeded
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.outcome import called
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.naming.naming import Naming


class IMap2D:
    """The interface under YARP's names (`yarp/dev/IMap2D.h`). What C++ returns by reference is filled in here too.

    Nothing raises: a call that fails returns an outcome that is false. Lists of results are cleared and filled.

    Args:
        remote: the server.
    """

    def __init__(self, remote: IMap2DMsgs) -> None:
        self._remote = remote

    def clearAllMaps(self) -> ReturnValue:
        """Forget all maps."""
        return called(self._remote.clear_all_maps_RPC)

    def store_map(self, themap: MapGrid2D) -> ReturnValue:
        """Keep a map under its own name, in place of one that has it."""
        return called(self._remote.store_map_RPC, themap)

    def get_map(self, map_name: str, themap: MapGrid2D) -> ReturnValue:
        """Take a map."""
        return called(self._remote.get_map_RPC, map_name, into=themap)

    def get_map_names(self, map_names: list[str]) -> ReturnValue:
        """The names of all maps."""
        return called(self._remote.get_map_names_RPC, into=map_names)

    def remove_map(self, map_name: str) -> ReturnValue:
        """Forget a map."""
        return called(self._remote.remove_map_RPC, map_name)

    def clearAllMapsTemporaryFlags(self) -> ReturnValue:
        """Take what is temporary out of all maps."""
        return called(self._remote.clear_all_maps_temporary_flags_RPC)

    def clearMapTemporaryFlags(self, map_name: str) -> ReturnValue:
        """Take what is temporary out of a map."""
        return called(self._remote.clear_map_temporary_flags_RPC, map_name)

    def enableMapsCompression(self, enable: bool) -> ReturnValue:
        """Send maps compressed, or not."""
        return called(self._remote.enable_maps_compression_RPC, enable)

    def storeObject(self, object_name: str, obj: Map2DObject) -> ReturnValue:
        """Keep an object under a name."""
        return called(self._remote.store_object_RPC, object_name, obj)

    def getObject(self, object_name: str, obj: Map2DObject) -> ReturnValue:
        """Take an object."""
        return called(self._remote.get_object_RPC, object_name, into=obj)

    def getObjectsList(self, objects: list[str]) -> ReturnValue:
        """The names of all objects."""
        return called(self._remote.get_objects_list_RPC, into=objects)

    def getAllObjects(self, objects: list[Map2DObject]) -> ReturnValue:
        """All objects, without their names."""
        return called(self._remote.get_all_objects_RPC, into=objects)

    def renameObject(self, original_name: str, new_name: str) -> ReturnValue:
        """Give an object another name."""
        return called(self._remote.rename_object_RPC, original_name, new_name)

    def deleteObject(self, object_name: str) -> ReturnValue:
        """Forget an object."""
        return called(self._remote.delete_object_RPC, object_name)

    def clearAllObjects(self) -> ReturnValue:
        """Forget all objects."""
        return called(self._remote.clear_all_objects_RPC)

    def storeLocation(self, location_name: str, loc: Map2DLocation) -> ReturnValue:
        """Keep a location under a name."""
        return called(self._remote.store_location_RPC, location_name, loc)

    def getLocation(self, location_name: str, loc: Map2DLocation) -> ReturnValue:
        """Take a location."""
        return called(self._remote.get_location_RPC, location_name, into=loc)

    def getLocationsList(self, locations: list[str]) -> ReturnValue:
        """The names of all locations."""
        return called(self._remote.get_locations_list_RPC, into=locations)

    def getAllLocations(self, locations: list[Map2DLocation]) -> ReturnValue:
        """All locations, without their names."""
        return called(self._remote.get_all_locations_RPC, into=locations)

    def renameLocation(self, original_name: str, new_name: str) -> ReturnValue:
        """Give a location another name."""
        return called(self._remote.rename_location_RPC, original_name, new_name)

    def deleteLocation(self, location_name: str) -> ReturnValue:
        """Forget a location."""
        return called(self._remote.delete_location_RPC, location_name)

    def clearAllLocations(self) -> ReturnValue:
        """Forget all locations."""
        return called(self._remote.clear_all_locations_RPC)

    def storeArea(self, area_name: str, area: Map2DArea) -> ReturnValue:
        """Keep an area under a name."""
        return called(self._remote.store_area_RPC, area_name, area)

    def getArea(self, area_name: str, area: Map2DArea) -> ReturnValue:
        """Take an area."""
        return called(self._remote.get_area_RPC, area_name, into=area)

    def getAreasList(self, areas: list[str]) -> ReturnValue:
        """The names of all areas."""
        return called(self._remote.get_areas_list_RPC, into=areas)

    def getAllAreas(self, areas: list[Map2DArea]) -> ReturnValue:
        """All areas, without their names."""
        return called(self._remote.get_all_areas_RPC, into=areas)

    def renameArea(self, original_name: str, new_name: str) -> ReturnValue:
        """Give an area another name."""
        return called(self._remote.rename_area_RPC, original_name, new_name)

    def deleteArea(self, area_name: str) -> ReturnValue:
        """Forget an area."""
        return called(self._remote.delete_area_RPC, area_name)

    def clearAllAreas(self) -> ReturnValue:
        """Forget all areas."""
        return called(self._remote.clear_all_areas_RPC)

    def storePath(self, path_name: str, path: Map2DPath) -> ReturnValue:
        """Keep a path under a name."""
        return called(self._remote.store_path_RPC, path_name, path)

    def getPath(self, path_name: str, path: Map2DPath) -> ReturnValue:
        """Take a path."""
        return called(self._remote.get_path_RPC, path_name, into=path)

    def getPathsList(self, paths: list[str]) -> ReturnValue:
        """The names of all paths."""
        return called(self._remote.get_paths_list_RPC, into=paths)

    def getAllPaths(self, paths: list[Map2DPath]) -> ReturnValue:
        """All paths, without their names."""
        return called(self._remote.get_all_paths_RPC, into=paths)

    def renamePath(self, original_name: str, new_name: str) -> ReturnValue:
        """Give a path another name."""
        return called(self._remote.rename_path_RPC, original_name, new_name)

    def deletePath(self, path_name: str) -> ReturnValue:
        """Forget a path."""
        return called(self._remote.delete_path_RPC, path_name)

    def clearAllPaths(self) -> ReturnValue:
        """Forget all paths."""
        return called(self._remote.clear_all_paths_RPC)

    def saveMapToDisk(self, map_name: str, file_name: str) -> ReturnValue:
        """Write a map into a file of the server's machine."""
        return called(self._remote.save_map_to_disk_RPC, map_name, file_name)

    def loadMapFromDisk(self, file_name: str) -> ReturnValue:
        """Read a map from a file of the server's machine."""
        return called(self._remote.load_map_from_disk_RPC, file_name)

    def saveMapsCollection(self, file_name: str) -> ReturnValue:
        """Write all maps into files, and their list."""
        return called(self._remote.save_maps_collection_RPC, file_name)

    def loadMapsCollection(self, file_name: str) -> ReturnValue:
        """Read the maps of such a list."""
        return called(self._remote.load_maps_collection_RPC, file_name)

    def saveLocationsAndExtras(self, file_name: str) -> ReturnValue:
        """Write all locations, objects, areas and paths."""
        return called(self._remote.save_locations_and_extras_RPC, file_name)

    def loadLocationsAndExtras(self, file_name: str) -> ReturnValue:
        """Read such a file."""
        return called(self._remote.load_locations_and_extras_RPC, file_name)

    def reloadMapsCollection(self) -> ReturnValue:
        """Read the collection of the server's start again."""
        return called(self._remote.reload_maps_collection_RPC)

    def reloadLocationsAndExtras(self) -> ReturnValue:
        """Read the locations of the server's start again."""
        return called(self._remote.reload_locations_and_extras_RPC)


class Map2DClient(ServiceClient[IMap2DMsgs], IMap2D):
    """A client of a map server, between ``with`` and its end.

    Args:
        server: its port.
        name: the own port's name; empty lets the name server choose one.
        timeout: seconds to wait for a reply; None: for ever.
        naming: who knows the names; by default the name server of ``yarp.conf``.

    Attributes:
        maps: by name.
        objects: by name.
        locations: by name.
        areas: by name.
        paths: by name.
    """

    def __init__(
        self,
        server: str = "/map2D_nws_yarp/rpc",
        name: str = "",
        *,
        timeout: float | None = PATIENCE,
        naming: Naming | None = None,
    ) -> None:
        ServiceClient.__init__(self, IMap2DMsgs, server, name, timeout=timeout, naming=naming)
        IMap2D.__init__(self, self.remote)
        self.maps = Maps(self.remote)
        self.objects: Places[Map2DObject] = Places(self.remote, "object")
        self.locations: Places[Map2DLocation] = Places(self.remote, "location")
        self.areas: Places[Map2DArea] = Places(self.remote, "area")
        self.paths: Places[Map2DPath] = Places(self.remote, "path")

    def save_places(self, file_name: str) -> None:
        """Have the server write all locations, objects, areas and paths; raises `CallFailed` where it refuses."""
        succeeded(self.remote.save_locations_and_extras_RPC(file_name))

    def load_places(self, file_name: str) -> None:
        """Have the server read such a file; raises `CallFailed` where it refuses."""
        succeeded(self.remote.load_locations_and_extras_RPC(file_name))

    def reload_places(self) -> None:
        """Have the server read the file of its start again; raises `CallFailed` where it refuses."""
        succeeded(self.remote.reload_locations_and_extras_RPC())

"""IMap2D on the wire: maps, and places on them, that a server keeps (`devices/messages/IMap2DMsgs/IMap2DMsgs.thrift`).

Requests are the same in all releases from 3.6 on; objects and ``reload`` came with 3.12. Replies differ, see
`yarp_compat.dev.returnvalue`. A ``get`` that fails has a default beside its outcome; ``get_all`` gives no names.
"""

# mypy: disable-error-code="empty-body"

from __future__ import annotations

from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.dev.service import Service, rpc


class IMap2DMsgs(Service):
    """What a map server's port answers; methods as YARP's service has them."""

    # -- maps ---------------------------------------------------------------------------------------------------------

    @rpc
    def clear_all_maps_RPC(self) -> ReturnValue:
        """Forget all maps."""

    @rpc
    def store_map_RPC(self, themap: MapGrid2D) -> ReturnValue:
        """Keep a map under its own name, in place of one that has it."""

    @rpc
    def get_map_RPC(self, map_name: str) -> tuple[ReturnValue, MapGrid2D]:
        """A map."""

    @rpc
    def get_map_names_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all maps."""

    @rpc
    def remove_map_RPC(self, map_name: str) -> ReturnValue:
        """Forget a map."""

    @rpc
    def clear_all_maps_temporary_flags_RPC(self) -> ReturnValue:
        """Take what is temporary out of all maps: obstacles, and those enlarged."""

    @rpc
    def clear_map_temporary_flags_RPC(self, map_name: str) -> ReturnValue:
        """Take what is temporary out of a map."""

    @rpc
    def enable_maps_compression_RPC(self, enable_compression: bool) -> ReturnValue:
        """Send maps compressed, or not."""

    # -- objects ------------------------------------------------------------------------------------------------------

    @rpc
    def store_object_RPC(self, object_name: str, loc: Map2DObject) -> ReturnValue:
        """Keep an object under a name."""

    @rpc
    def get_object_RPC(self, object_name: str) -> tuple[ReturnValue, Map2DObject]:
        """An object."""

    @rpc
    def get_objects_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all objects."""

    @rpc
    def get_all_objects_RPC(self) -> tuple[ReturnValue, list[Map2DObject]]:
        """All objects, in the order of their names."""

    @rpc
    def rename_object_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        """Give an object another name."""

    @rpc
    def delete_object_RPC(self, object_name: str) -> ReturnValue:
        """Forget an object."""

    @rpc
    def clear_all_objects_RPC(self) -> ReturnValue:
        """Forget all objects."""

    # -- locations ----------------------------------------------------------------------------------------------------

    @rpc
    def store_location_RPC(self, location_name: str, loc: Map2DLocation) -> ReturnValue:
        """Keep a location under a name."""

    @rpc
    def get_location_RPC(self, location_name: str) -> tuple[ReturnValue, Map2DLocation]:
        """A location."""

    @rpc
    def get_locations_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all locations."""

    @rpc
    def get_all_locations_RPC(self) -> tuple[ReturnValue, list[Map2DLocation]]:
        """All locations, in the order of their names."""

    @rpc
    def rename_location_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        """Give a location another name."""

    @rpc
    def delete_location_RPC(self, location_name: str) -> ReturnValue:
        """Forget a location."""

    @rpc
    def clear_all_locations_RPC(self) -> ReturnValue:
        """Forget all locations."""

    # -- areas --------------------------------------------------------------------------------------------------------

    @rpc
    def store_area_RPC(self, area_name: str, area: Map2DArea) -> ReturnValue:
        """Keep an area under a name."""

    @rpc
    def get_area_RPC(self, area_name: str) -> tuple[ReturnValue, Map2DArea]:
        """An area."""

    @rpc
    def get_areas_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all areas."""

    @rpc
    def get_all_areas_RPC(self) -> tuple[ReturnValue, list[Map2DArea]]:
        """All areas, in the order of their names."""

    @rpc
    def rename_area_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        """Give an area another name."""

    @rpc
    def delete_area_RPC(self, area_name: str) -> ReturnValue:
        """Forget an area."""

    @rpc
    def clear_all_areas_RPC(self) -> ReturnValue:
        """Forget all areas."""

    # -- paths --------------------------------------------------------------------------------------------------------

    @rpc
    def store_path_RPC(self, path_name: str, path: Map2DPath) -> ReturnValue:
        """Keep a path under a name."""

    @rpc
    def get_path_RPC(self, path_name: str) -> tuple[ReturnValue, Map2DPath]:
        """A path."""

    @rpc
    def get_paths_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all paths."""

    @rpc
    def get_all_paths_RPC(self) -> tuple[ReturnValue, list[Map2DPath]]:
        """All paths, in the order of their names."""

    @rpc
    def rename_path_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        """Give a path another name."""

    @rpc
    def delete_path_RPC(self, path_name: str) -> ReturnValue:
        """Forget a path."""

    @rpc
    def clear_all_paths_RPC(self) -> ReturnValue:
        """Forget all paths."""

    # -- files --------------------------------------------------------------------------------------------------------

    @rpc
    def save_maps_collection_RPC(self, maps_collection_file: str) -> ReturnValue:
        """Write all maps, each into files of its own, and their list."""

    @rpc
    def load_maps_collection_RPC(self, maps_collection_file: str) -> ReturnValue:
        """Read the maps of such a list."""

    @rpc
    def save_locations_and_extras_RPC(self, locations_collection_file: str) -> ReturnValue:
        """Write all locations, objects, areas and paths."""

    @rpc
    def load_locations_and_extras_RPC(self, locations_collection_file: str) -> ReturnValue:
        """Read such a file."""

    @rpc
    def save_map_to_disk_RPC(self, map_name: str, file_name: str) -> ReturnValue:
        """Write a map."""

    @rpc
    def load_map_from_disk_RPC(self, file_name: str) -> ReturnValue:
        """Read a map."""

    @rpc
    def reload_maps_collection_RPC(self) -> ReturnValue:
        """Read the collection of the server's start again."""

    @rpc
    def reload_locations_and_extras_RPC(self) -> ReturnValue:
        """Read the locations of the server's start again."""

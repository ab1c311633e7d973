"""IMap2D on the wire: maps, and places on them, that a server keeps (`devices/messages/IMap2DMsgs/IMap2DMsgs.thrift`).

Requests are the same in all releases from 3.6 on; objects and ``reload`` came with 3.12. Replies differ, see
`yarp_compat.dev.returnvalue`. A ``get`` that fails has a default beside its outcome; ``get_all`` gives no names.
"""

# mypy: disable-error-code="empty-body"

from __future__ import annotations

from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.dev.service import Service, rpc, since
from yarp_compat.wire.generation import Generation


@rpc
class IMap2DMsgs(Service):
    """The methods of a map server's port, as YARP's service has them."""

    # -- maps ---------------------------------------------------------------------------------------------------------

    def clear_all_maps_RPC(self) -> ReturnValue:
        """Forget all maps."""

    def store_map_RPC(self, themap: MapGrid2D) -> ReturnValue:
        """Keep a map under its own name, in place of one that has it."""

    def get_map_RPC(self, map_name: str) -> tuple[ReturnValue, MapGrid2D]:
        """A map."""

    def get_map_names_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all maps."""

    def remove_map_RPC(self, map_name: str) -> ReturnValue:
        """Forget a map."""

    def clear_all_maps_temporary_flags_RPC(self) -> ReturnValue:
        """Take what is temporary out of all maps: obstacles, and those enlarged."""

    def clear_map_temporary_flags_RPC(self, map_name: str) -> ReturnValue:
        """Take what is temporary out of a map."""

    def enable_maps_compression_RPC(self, enable_compression: bool) -> ReturnValue:
        """Send maps compressed, or not."""

    # -- objects ------------------------------------------------------------------------------------------------------

    @since(Generation.YARP_3_12)
    def store_object_RPC(self, object_name: str, loc: Map2DObject) -> ReturnValue:
        """Keep an object under a name."""

    @since(Generation.YARP_3_12)
    def get_object_RPC(self, object_name: str) -> tuple[ReturnValue, Map2DObject]:
        """An object."""

    @since(Generation.YARP_3_12)
    def get_objects_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all objects."""

    @since(Generation.YARP_3_12)
    def get_all_objects_RPC(self) -> tuple[ReturnValue, list[Map2DObject]]:
        """All objects, in the order of their names."""

    @since(Generation.YARP_3_12)
    def rename_object_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        """Give an object another name."""

    @since(Generation.YARP_3_12)
    def delete_object_RPC(self, object_name: str) -> ReturnValue:
        """Forget an object."""

    @since(Generation.YARP_3_12)
    def clear_all_objects_RPC(self) -> ReturnValue:
        """Forget all objects."""

    # -- locations ----------------------------------------------------------------------------------------------------

    def store_location_RPC(self, location_name: str, loc: Map2DLocation) -> ReturnValue:
        """Keep a location under a name."""

    def get_location_RPC(self, location_name: str) -> tuple[ReturnValue, Map2DLocation]:
        """A location."""

    def get_locations_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all locations."""

    def get_all_locations_RPC(self) -> tuple[ReturnValue, list[Map2DLocation]]:
        """All locations, in the order of their names."""

    def rename_location_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        """Give a location another name."""

    def delete_location_RPC(self, location_name: str) -> ReturnValue:
        """Forget a location."""

    def clear_all_locations_RPC(self) -> ReturnValue:
        """Forget all locations."""

    # -- areas --------------------------------------------------------------------------------------------------------

    def store_area_RPC(self, area_name: str, area: Map2DArea) -> ReturnValue:
        """Keep an area under a name."""

    def get_area_RPC(self, area_name: str) -> tuple[ReturnValue, Map2DArea]:
        """An area."""

    def get_areas_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all areas."""

    def get_all_areas_RPC(self) -> tuple[ReturnValue, list[Map2DArea]]:
        """All areas, in the order of their names."""

    def rename_area_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        """Give an area another name."""

    def delete_area_RPC(self, area_name: str) -> ReturnValue:
        """Forget an area."""

    def clear_all_areas_RPC(self) -> ReturnValue:
        """Forget all areas."""

    # -- paths --------------------------------------------------------------------------------------------------------

    def store_path_RPC(self, path_name: str, path: Map2DPath) -> ReturnValue:
        """Keep a path under a name."""

    def get_path_RPC(self, path_name: str) -> tuple[ReturnValue, Map2DPath]:
        """A path."""

    def get_paths_list_RPC(self) -> tuple[ReturnValue, list[str]]:
        """The names of all paths."""

    def get_all_paths_RPC(self) -> tuple[ReturnValue, list[Map2DPath]]:
        """All paths, in the order of their names."""

    def rename_path_RPC(self, original_name: str, new_name: str) -> ReturnValue:
        """Give a path another name."""

    def delete_path_RPC(self, path_name: str) -> ReturnValue:
        """Forget a path."""

    def clear_all_paths_RPC(self) -> ReturnValue:
        """Forget all paths."""

    # -- files --------------------------------------------------------------------------------------------------------

    def save_maps_collection_RPC(self, maps_collection_file: str) -> ReturnValue:
        """Write all maps, each into files of its own, and their list."""

    def load_maps_collection_RPC(self, maps_collection_file: str) -> ReturnValue:
        """Read the maps of such a list."""

    def save_locations_and_extras_RPC(self, locations_collection_file: str) -> ReturnValue:
        """Write all locations, objects, areas and paths."""

    def load_locations_and_extras_RPC(self, locations_collection_file: str) -> ReturnValue:
        """Read such a file."""

    def save_map_to_disk_RPC(self, map_name: str, file_name: str) -> ReturnValue:
        """Write a map."""

    def load_map_from_disk_RPC(self, file_name: str) -> ReturnValue:
        """Read a map."""

    @since(Generation.YARP_3_12)
    def reload_maps_collection_RPC(self) -> ReturnValue:
        """Read the collection of the server's start again."""

    @since(Generation.YARP_3_12)
    def reload_locations_and_extras_RPC(self) -> ReturnValue:
        """Read the locations of the server's start again."""

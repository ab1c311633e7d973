"""Map2DServer: serves the store's maps and places to YARP clients, ROS 1 and ROS 2, and their planners."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="map2d_server",
    factory="navigation.map2d_server.module:Map2DServer",
    section="navigation.map2d_server.section:Map2DServerSection",
    about="The maps and places of the store for YARP, ROS 1 and ROS 2; see docs/navigation/maps.md.",
    accepts="navigation.map2d_server.checks:accepts",
)

"""Mapper2D: builds a map from a laser and odometry or a given pose; people can paint on it meanwhile."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="mapper2d",
    factory="navigation.mapper2d.module:Mapper2D",
    section="navigation.mapper2d.section:Mapper2DSection",
    about="Builds a map from a laser, with drifting odometry or a known pose; see docs/navigation/mapper2d.md.",
)

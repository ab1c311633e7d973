"""Mapper3D: builds an octree from clouds and depth images, and a grid of the obstacles that the robot would touch."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="mapper3d",
    factory="navigation.mapper3d.module:Mapper3D",
    section="navigation.mapper3d.section:Mapper3DSection",
    about="Builds an octree from clouds and depth images; see docs/navigation/mapper3d.md.",
)

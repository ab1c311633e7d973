"""The transform server, a hosted module that exchanges frames between YARP programs, the hub and other programs."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="transform_server",
    factory="bridge.transform_server.module:TransformServer",
    section="bridge.transform_server.section:TransformServerSection",
    about="The frames of all sides for YARP programs; see docs/sides/frames.md.",
)

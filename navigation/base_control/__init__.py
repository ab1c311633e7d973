"""BaseControl: drives a mobile base as its inputs command, within its limits, and publishes its odometry."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="base_control",
    factory="navigation.base_control.module:BaseControl",
    section="navigation.base_control.section:BaseControlSection",
    about="Drives a mobile base as its inputs command; see docs/navigation/base_control.md.",
)

"""LocalizationServer: publishes the robot's pose, from Midspan's own localizer or from an external localizer."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="localization_server",
    factory="navigation.localization_server.module:LocalizationServer",
    section="navigation.localization_server.section:LocalizationServerSection",
    about="Where the robot is, for all sides, with Midspan's own localizer; see docs/navigation/localization.md.",
)

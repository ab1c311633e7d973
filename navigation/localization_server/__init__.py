"""LocalizationServer: publishes the robot's pose, from Midspan's own localizer or from an external localizer."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="localization_server",
    factory="navigation.localization_server.module:LocalizationServer",
    section="navigation.localization_server.section:LocalizationServerSection",
    about="The robot's pose for all sides, by Midspan's own localizer or another; see docs/navigation/localization.md.",
)

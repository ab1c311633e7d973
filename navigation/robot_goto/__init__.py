"""The module RobotGoto: drives to a goal with only a laser and transforms."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="robot_goto",
    factory="navigation.robot_goto.module:RobotGoto",
    section="navigation.robot_goto.section:RobotGotoSection",
    about="Drives to a goal with only laser and frames; see docs/navigation/robot_goto.md.",
)

"""Control boards of YARP robots on the hub, as joint states and commands to joints."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="control_boards",
    factory="bridge.boards.module:ControlBoards",
    section="bridge.boards.section:ControlBoardsSection",
    about="Joints of a YARP robot's control boards as `JointState`; see docs/sides/yarp.md.",
)

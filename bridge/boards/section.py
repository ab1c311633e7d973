"""The section ``modules.control_boards``: joints of a YARP robot on the hub."""

from __future__ import annotations

from pydantic import Field
from typing_extensions import override

from bridge.config.sections.section import ModuleSection, OptionalTopic, PortName, Section, TopicName, setting

JOINTS = "sensor_msgs/msg/JointState"


class ControlBoardSection(Section):
    """A YARP control board, whose joints appear on the hub."""

    remote: PortName = Field(description="Prefix of the names of the board's ports, such as `/cer/mobile_base`.")
    joint_states: TopicName = setting("/joint_states", "Topic of the joint states on the hub (`JointState`, radians).")
    command: OptionalTopic = setting(
        "", "Topic of commands to the joints (`JointState`: velocities, or positions); empty: no commands."
    )
    joints: tuple[str, ...] = setting((), "Joint names, in the board's order; empty: the names that the board reports.")
    timeout: float = setting(0.2, "A joint stops this many seconds after its last command.", gt=0.0, le=0.5)


class ControlBoardsSection(ModuleSection):
    """Joints of a YARP robot's control boards."""

    boards: tuple[ControlBoardSection, ...] = setting((), "The boards.")

    @property
    @override
    def driven(self) -> tuple[tuple[str, str], ...]:
        return tuple((board.command, JOINTS) for board in self.boards if board.command)

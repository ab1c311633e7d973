"""The section ``modules.control_boards``: joints of a YARP robot on the hub."""

from __future__ import annotations

from pydantic import Field
from typing_extensions import override

from bridge.config.sections.section import ModuleSection, OptionalTopic, PortName, Section, TopicName, setting


class ControlBoardSection(Section):
    """One board."""

    remote: PortName = Field(description="What the names of the board's ports begin with: `/cer/mobile_base`.")
    joint_states: TopicName = setting("/joint_states", "Topic of its joints' state on the hub (`JointState`, radians).")
    command: OptionalTopic = setting(
        "", "Topic of commands to its joints (`JointState`: velocities, or positions); empty: it takes none."
    )
    joints: tuple[str, ...] = setting((), "Names of its joints, in its order; empty: the names that the board reports.")
    timeout: float = setting(0.2, "Seconds after its last command at which a joint stops.", gt=0.0, le=0.5)


class ControlBoardsSection(ModuleSection):
    """Joints of a YARP robot's control boards."""

    boards: tuple[ControlBoardSection, ...] = setting((), "The boards.")

    @property
    @override
    def driven(self) -> tuple[str, ...]:
        return tuple(board.command for board in self.boards)

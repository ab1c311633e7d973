"""The section ``ros1``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from bridge.config.sections.section import Enabled, Section
from bridge.config.sections.values import MasterUri, NodeName


class Ros1Section(Section):
    """The ROS 1 side."""

    enabled: Enabled = Field(default="auto", description="`auto`: where rospy is installed.")
    master: MasterUri | None = Field(
        default=None, description="ROS master URI; default $ROS_MASTER_URI or http://localhost:11311."
    )
    ip: str | None = Field(default=None, description="Address that this machine gives to ROS 1 peers (ROS_IP).")
    hostname: str | None = Field(
        default=None, description="Host name that this machine gives to ROS 1 peers (ROS_HOSTNAME)."
    )
    node: NodeName = Field(default="midspan", description="Node name on the ROS 1 graph.")
    poll: float = Field(
        default=0.5,
        ge=0.05,
        le=10,
        description="Seconds between looks at the master's graph; up to 2 where it has hundreds of topics.",
    )
    goal_frames: Literal["check", "pass"] = Field(
        default="check",
        description="Goals of actions: `check` takes leading slashes off their frames and rejects goals in frames that"
        " no transform of this side names, which a move_base would follow for ever; `pass` leaves them as they are.",
    )
    packages: Path | None = Field(
        default=None, description="Folder with the ROS 1 Python packages; default the system's dist-packages."
    )

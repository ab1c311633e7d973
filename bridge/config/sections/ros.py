"""The sections ``ros1`` and ``ros2``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from bridge.config.sections.section import Enabled, MasterUri, NodeName, SideSection, setting


class Ros1Section(SideSection):
    """The ROS 1 side."""

    enabled: Enabled = setting("auto", "`auto`: if rospy is installed.")
    master: MasterUri | None = setting(None, "ROS master URI; default $ROS_MASTER_URI or http://localhost:11311.")
    ip: str | None = setting(None, "Address that this machine gives to ROS 1 peers (ROS_IP).")
    hostname: str | None = setting(None, "Host name that this machine gives to ROS 1 peers (ROS_HOSTNAME).")
    node: NodeName = setting("midspan", "Node name on the ROS 1 graph.")
    poll: float = setting(
        0.5, "Seconds between two polls of the master; up to 2 with hundreds of topics.", ge=0.05, le=10
    )
    goal_frames: Literal["check", "pass"] = setting(
        "check",
        "Frames of action goals: `check` removes leading slashes and rejects goals in frames that no transform of this"
        " side names, which a move_base would follow for ever; `pass` leaves them unchanged.",
    )
    packages: Path | None = setting(None, "Folder with the ROS 1 Python packages; default the system's dist-packages.")


class Ros2Section(SideSection):
    """The ROS 2 (DDS) side."""

    enabled: Enabled = setting("auto", "`auto`: if rclpy is installed.")
    domain: int | None = setting(None, "ROS_DOMAIN_ID; default the environment's, else 0.", ge=0, le=232)
    node: NodeName = setting("midspan", "Node name on the ROS 2 graph.")
    transport: Literal["auto", "shared_memory", "udp"] = setting(
        "auto",
        "Fast DDS transports. `auto`: shared memory and UDP; only UDP if /dev/shm is too small, or other users run"
        " ROS 2 nodes here (shared memory delivers nothing between users).",
    )
    profile: Path | None = setting(None, "Your own Fast DDS XML profile, used instead of the generated one.")
    localhost_only: bool = setting(True, "Discover ROS 2 nodes of this machine only.")

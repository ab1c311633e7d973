"""The section ``ros2``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from bridge.config.sections.section import Enabled, Section
from bridge.config.sections.values import NodeName


class Ros2Section(Section):
    """The ROS 2 (DDS) side."""

    enabled: Enabled = Field(default="auto", description="`auto`: where rclpy is installed.")
    domain: int | None = Field(
        default=None, ge=0, le=232, description="ROS_DOMAIN_ID; default the environment's, else 0."
    )
    node: NodeName = Field(default="midspan", description="Node name on the ROS 2 graph.")
    transport: Literal["auto", "shared_memory", "udp"] = Field(
        default="auto",
        description="Fast DDS transports. `auto`: shared memory beside UDP, UDP alone where /dev/shm is too small or"
        " other users' ROS 2 nodes are on this machine (shared memory delivers nothing between users).",
    )
    profile: Path | None = Field(
        default=None, description="A Fast DDS XML profile of your own, used instead of the generated one."
    )
    localhost_only: bool = Field(default=True, description="Discover ROS 2 nodes of this machine only.")

"""What every section of the configuration is, and values that several of them have."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

SideName = Literal["ros1", "ros2", "yarp", "zenoh", "zenoh_ros2dds", "zenoh_ros1", "zenoh_json"]
Enabled = Literal["auto", True, False]


class Section(BaseModel):
    """Base of all sections: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)

"""The section ``modules.transform_server``: the frames of all sides, given to YARP."""

from __future__ import annotations

import re
from typing import Literal

from pydantic import Field, field_validator

from bridge.config.sections.module import ModuleSection

_PREFIX = re.compile(r"(?:/[^\s/\"'*()\[\]{}]+)*")


class TransformServerSection(ModuleSection):
    """The server of frames for YARP's `frameTransformClient`."""

    prefix: str = Field(
        default="",
        description="Begins the names of its ports: `/robot` for `/robot/frameTransformServer/...`, as YARP's"
        " `ft_server_prefix`.",
    )
    period: float = Field(
        default=0.01, ge=0.001, le=1.0, description="Seconds between two messages of the streaming port `tf:o`."
    )
    yarp_frame_lifetime: float = Field(
        default=0.2,
        ge=0.01,
        le=3600.0,
        description="Seconds after its stamp for which a frame that a YARP program set is there for YARP programs.",
    )
    ros_frame_lifetime: float = Field(
        default=1.0,
        ge=0.01,
        le=3600.0,
        description="Seconds for which a frame of `/tf` is given to YARP programs after it was heard; as long as the"
        " slowest one's period.",
    )
    clock: Literal["run", "system"] = Field(
        default="run",
        description="What YARP programs run on. `run`: this run's clock (with `clock.source: sim` they have"
        " `YARP_CLOCK=/midspan/clock:o`); `system`: the machine's, also in a simulation.",
    )
    cache_time: float = Field(
        default=10.0, gt=0.0, le=600.0, description="Seconds of history before each frame's newest."
    )
    max_future: float = Field(
        default=2.0, ge=0.0, le=60.0, description="Seconds that a stamp may be ahead of the clock; others are refused."
    )

    buffer_server: bool = Field(
        default=True,
        description="Serve the action `/tf2_buffer_server` and the service `/tf2_frames`, by which tf2_ros's"
        " `BufferClient` looks up transforms. Off where another program serves them.",
    )

    @field_validator("prefix")
    @classmethod
    def _prefix_is_one(cls, value: str) -> str:
        if not _PREFIX.fullmatch(value):
            msg = f"{value!r} cannot begin a port's name: write it as /robot"
            raise ValueError(msg)
        return value

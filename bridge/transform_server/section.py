"""The section ``modules.transform_server``."""

from __future__ import annotations

from typing import Literal

from bridge.config.sections.section import (
    ModuleSection,
    OptionalPort,
    setting,
)


class TransformServerSection(ModuleSection):
    """The server of frames for YARP's `frameTransformClient`."""

    prefix: OptionalPort = setting(
        "", "Prefix of the ports: `/robot` for `/robot/frameTransformServer/...`, like YARP's `ft_server_prefix`."
    )
    period: float = setting(0.01, "Seconds between two messages of the port `tf:o`.", ge=0.001, le=1.0)
    yarp_frame_lifetime: float = setting(
        0.2,
        "Seconds for which YARP programs see a frame that a YARP program has set, counted from the frame's stamp.",
        ge=0.01,
        le=3600.0,
    )
    ros_frame_lifetime: float = setting(
        1.0,
        "Longest period at which frames of `/tf` are sent, in seconds. YARP programs see each frame for 1.25 times this"
        " period after it arrives.",
        ge=0.01,
        le=3600.0,
    )
    clock: Literal["run", "system"] = setting(
        "run",
        "Clock of the YARP programs. `run`: this run's clock (with `clock.source: sim` they use"
        " `YARP_CLOCK=/midspan/clock:o`); `system`: the machine's, also in a simulation.",
    )
    cache_time: float = setting(10.0, "Seconds of history kept before each frame's newest transform.", gt=0.0, le=600.0)
    max_future: float = setting(2.0, "Seconds that a stamp may be ahead of the clock.", ge=0.0, le=60.0)

    buffer_server: bool = setting(
        True,
        "Serve `/tf2_buffer_server` and `/tf2_frames` for tf2_ros's `BufferClient`; set it to false if another node"
        " serves them.",
    )

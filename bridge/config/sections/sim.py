"""The section ``sim``: the simulated base."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import Field, field_validator

from bridge.config.sections.section import Section

_PREFIX = re.compile(r"(?:/[A-Za-z0-9_]+)*")


class LaserSection(Section):
    """The laser of the simulated base."""

    kind: Literal["ideal", "robot"] = Field(
        default="ideal",
        description="`ideal`: one scanner in the base's middle that sees all around; `robot`: the robot's own ones,"
        " blended into one (the R1's two are blind to the sides: NaN).",
    )
    beams: int = Field(default=720, ge=4, le=20_000, description="Of one turn. The R1's has 1600.")
    rate: float = Field(default=10.0, gt=0, le=100, description="Turns per second.")
    nearest: float = Field(default=0.1, ge=0, description="Metres; what is nearer is NaN.")
    farthest: float = Field(default=20.0, gt=0, le=1000, description="Metres; what is farther is infinite.")
    noise: float = Field(default=0.0, ge=0, le=1, description="Standard deviation of a distance, metres.")
    resolution: float = Field(default=0.0, ge=0, le=1, description="Distances are rounded to it, metres; 0: not.")
    dropouts: float = Field(default=0.0, ge=0, le=1, description="Share of beams that come back empty (NaN).")


class EncodersSection(Section):
    """Errors of the wheels' encoders, by which odometry drifts."""

    scale: tuple[Annotated[float, Field(gt=-1, le=1)], ...] = Field(
        default=(),
        description="How much more each wheel's encoder says than the wheel turned: `[0.01, 0.01]` is 1 %; empty: 0.",
    )
    noise: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Standard deviation after one radian, in radians; it adds up as the wheel turns.",
    )


class SimSection(Section):
    """The R1's base, or another, in DART."""

    enabled: bool = Field(default=False, description="Whether the worker `sim` runs.")
    plan: str = Field(
        default="apartment",
        description="Where the robot is: `apartment`, `office`, `lab`, `hall`, `two_storeys`, or a file: a plan (YAML),"
        " a ROS or YARP map, or an image.",
    )
    resolution: float = Field(default=0.05, gt=0, le=10, description="Metres per pixel of an image as plan.")
    robot: str = Field(default="r1", description="`r1`, `r1_gazebo`, `ikart_v1`, or a file that describes another.")
    start: tuple[float, float, float] | None = Field(
        default=None, description="Where the robot begins: x, y (metres), direction (degrees); empty: as the plan says."
    )
    people: bool = Field(default=True, description="Whether the plan's people walk about.")
    speed: float | Literal["max", "step"] = Field(
        default=1.0,
        description="`1.0`: real time, or so many times as fast; `max`: as fast as possible; `step`: only when a client"
        " steps it. Other than 1, it publishes `/clock`; then set `clock.source` to `sim`.",
    )
    seed: int = Field(default=0, ge=0, description="Of all noise: the same seed and commands give the same run.")
    drive: Literal["velocity", "wheels"] = Field(
        default="velocity",
        description="`velocity`: it takes `/cmd_vel` and publishes odometry; `wheels`: BaseControl does both, and"
        " drives the wheels.",
    )
    names: Literal["usual", "r1"] = Field(
        default="usual",
        description="Of topics and frames: `usual`: `/scan`, `/odom`, `base_link`; `r1`: the robot's own, `/laser`,"
        " `/odometry`, `mobile_base_body_link`.",
    )
    yarp: str = Field(
        default="", description="What its YARP ports begin with: `/cer`, `/SIM_CER_ROBOT`; empty: it has none."
    )
    view: float = Field(default=0.0, ge=0, le=10, description="Pictures of the floor per second, as an Image; 0: none.")
    laser: LaserSection = Field(default_factory=LaserSection, description="Its laser.")
    encoders: EncodersSection = Field(default_factory=EncodersSection, description="Errors of its encoders.")

    @field_validator("speed")
    @classmethod
    def _is_a_speed(cls, value: float | str) -> float | str:
        if isinstance(value, float) and not 0.01 <= value <= 1000:
            msg = "a speed is 0.01 to 1000, `max` or `step`"
            raise ValueError(msg)
        return value

    @field_validator("yarp")
    @classmethod
    def _is_a_prefix(cls, value: str) -> str:
        if not _PREFIX.fullmatch(value):
            msg = f"{value!r} does not begin names of ports: it should look like /cer"
            raise ValueError(msg)
        return value

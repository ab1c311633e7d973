"""The sections ``sim`` and ``clock``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from bridge.config.sections.section import Section, matching, setting, subsection


class ClockSection(Section):
    """The time scale of all stamps that Midspan makes."""

    source: Literal["system", "sim"] = setting(
        "system", "`system`: the machine's; `sim`: the topic `/clock`, and ROS 1's master gets `/use_sim_time`."
    )

    @property
    def simulated(self) -> bool:
        """Whether the time is that of ``/clock``."""
        return self.source == "sim"


_Prefix = Annotated[str, matching(r"(?:/[A-Za-z0-9_]+)*", "is not a prefix of port names: write it as /cer")]

_Part = Annotated[str, matching(r"[A-Za-z0-9_]+", "is no part of a port's name: write it as mobile_base")]


class LaserSection(Section):
    """The laser of the simulated base."""

    kind: Literal["ideal", "robot"] = setting(
        "ideal",
        "`ideal`: one scanner in the base's middle that sees all around; `robot`: the robot's own scanners, merged"
        " into one scan (the R1's two are blind to the sides: NaN).",
    )
    beams: int = setting(720, "Beams per turn. The R1's has 1600.", ge=4, le=20_000)
    rate: float = setting(10.0, "Turns per second.", gt=0, le=100)
    nearest: float = setting(0.1, "Metres; nearer beams are NaN.", ge=0)
    farthest: float = setting(20.0, "Metres; farther beams are infinite.", gt=0, le=1000)
    noise: float = setting(0.0, "Standard deviation of a distance, metres.", ge=0, le=1)
    resolution: float = setting(0.0, "Metres to which distances are rounded; 0: not rounded.", ge=0, le=1)
    dropouts: float = setting(0.0, "Share of beams that come back empty (NaN).", ge=0, le=1)


class EncodersSection(Section):
    """Errors of the wheels' encoders, by which odometry drifts."""

    scale: tuple[Annotated[float, Field(gt=-1, le=1)], ...] = setting(
        (), "Relative error of each wheel's encoder: `[0.01, 0.01]` reports 1 % too much; empty: 0."
    )
    noise: float = setting(0.0, "Standard deviation after one radian, in radians; it adds up.", ge=0, le=1)


class SimSection(Section):
    """The R1's base, or another, in DART."""

    enabled: bool = setting(False, "Whether the worker `sim` runs.")
    plan: str = setting(
        "apartment", "`apartment`, `office`, `lab`, `hall`, `two_storeys`, or a file (plan, map, image)."
    )
    resolution: float = setting(0.05, "Metres per pixel of a plan that is an image.", gt=0, le=10)
    robot: str = setting("r1", "`r1`, `r1_gazebo`, `ikart_v1`, or a file that describes another robot.")
    start: tuple[float, float, float] | None = setting(
        None, "Where the robot starts: x, y (metres), direction (degrees); empty: as the plan says."
    )
    people: bool = setting(True, "Whether the plan's people walk about.")
    speed: float | Literal["max", "step"] = setting(
        1.0,
        "`1.0`: real time, or a multiple of it; `max`: as fast as possible; `step`: only when a client steps it. Other"
        " than 1, it publishes `/clock`; then set `clock.source` to `sim`.",
    )
    seed: int = setting(0, "Seed of all noise: the same seed and commands give the same run.", ge=0)
    drive: Literal["velocity", "wheels"] = setting(
        "velocity", "`velocity`: it takes `/cmd_vel` and publishes odometry; `wheels`: BaseControl does both."
    )
    names: Literal["usual", "r1"] = setting(
        "usual",
        "Names of topics and frames: `usual`: `/scan`, `/odom`, `base_link`; `r1`: the robot's own, `/laser`,"
        " `/odometry`, `mobile_base_body_link`.",
    )
    yarp: _Prefix = setting("", "Prefix of its YARP ports: `/cer`, `/SIM_CER_ROBOT`; empty: it has none.")
    part: _Part = setting(
        "mobile_base", "The wheels' control board among its YARP ports: `/cer/mobile_base` with `yarp: /cer`."
    )
    view: float = setting(0.0, "Pictures of the floor per second, as `Image`; 0: none.", ge=0, le=10)
    laser: LaserSection = subsection(LaserSection, "Its laser.")
    encoders: EncodersSection = subsection(EncodersSection, "Errors of its encoders.")

    @field_validator("speed")
    @classmethod
    def _is_a_speed(cls, value: float | str) -> float | str:
        if isinstance(value, float) and not 0.01 <= value <= 1000:
            raise ValueError("a speed is 0.01 to 1000, `max` or `step`")
        return value

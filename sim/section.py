"""The section ``sim``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator
from typing_extensions import override

from bridge.config.sections.section import Mistake, Section, matching, setting, subsection

WHEEL_COMMAND, JOINTS = "/wheel_command", "sensor_msgs/msg/JointState"

_Prefix = Annotated[str, matching(r"(?:/[A-Za-z0-9_]+)*", "is not a prefix of port names; write for instance /cer")]


def _named_or_file(value: str | Path) -> str | Path:
    return Path(value) if isinstance(value, str) and not re.fullmatch(r"[A-Za-z0-9_-]+", value) else value


_Description = Annotated[str | Path, AfterValidator(_named_or_file)]
"""The name of a plan or robot that comes with Midspan, or a file."""

_Reach = Annotated[float, Field(ge=-10, le=10)]

_Angle = Annotated[float, Field(ge=1, le=170)]

_Part = Annotated[str, matching(r"[A-Za-z0-9_]+", "is not a part of a port's name; write for instance mobile_base")]


class LaserSection(Section):
    """The laser of the simulated base."""

    kind: Literal["ideal", "robot"] = setting(
        "ideal",
        "`ideal`: one scanner with a full circle in the base's center; `robot`: the robot's own scanners, merged"
        " into one scan (the R1's two are blind to the sides: NaN).",
    )
    beams: int = setting(720, "Beams per scan. The R1's laser has 1600.", ge=4, le=20_000)
    rate: float = setting(10.0, "Scans per second.", gt=0, le=100)
    nearest: float = setting(0.1, "Minimum range, meters; nearer beams are NaN.", ge=0)
    farthest: float = setting(20.0, "Maximum range, meters; farther beams are infinite.", gt=0, le=1000)
    noise: float = setting(0.0, "Standard deviation of a distance, meters.", ge=0, le=1)
    resolution: float = setting(0.0, "Step to which distances are rounded, meters; 0: not rounded.", ge=0, le=1)
    dropouts: float = setting(0.0, "Share of beams without a value (NaN).", ge=0, le=1)

    @model_validator(mode="after")
    def _sees(self) -> LaserSection:
        if self.nearest >= self.farthest:
            raise ValueError("nearest must be less than farthest")
        return self


class EncodersSection(Section):
    """Errors of the wheels' encoders, which make the odometry drift."""

    scale: tuple[Annotated[float, Field(gt=-1, le=1)], ...] = setting(
        (), "Relative error of each wheel's encoder: `[0.01, 0.01]` reports 1 % too much; empty: 0."
    )
    noise: float = setting(
        0.0, "Standard deviation of the error per radian turned, in radians; the errors add up.", ge=0, le=1
    )


class CameraSection(Section):
    """The depth camera; the defaults are a RealSense D435 (Intel's data sheet 337029)."""

    rate: float = setting(0.0, "Images per second; 0: no camera.", ge=0, le=90)
    width: int = setting(640, "Width of the images, pixels.", ge=16, le=1280)
    height: int = setting(480, "Height of the images, pixels.", ge=16, le=960)
    fov: tuple[_Angle, _Angle] = setting((87.0, 58.0), "Horizontal and vertical field of view, degrees.")
    nearest: float = setting(0.3, "Minimum depth, meters; nearer pixels are minus infinity (`16UC1`: 0).", ge=0, le=10)
    farthest: float = setting(10.0, "Maximum depth, meters; farther pixels are infinite (`16UC1`: 0).", gt=0, le=65)
    at: tuple[_Reach, _Reach, _Reach] = setting(
        (0.1, 0.0, 1.1), "Position of the camera on the robot: meters ahead, to the left, above the floor."
    )
    pitch: float = setting(25.0, "Angle by which the camera is tilted down, degrees.", ge=-90, le=90)
    yaw: float = setting(0.0, "Angle by which the camera is turned to the left, degrees.", ge=-180, le=180)
    noise: float = setting(
        0.08,
        "Standard deviation of a disparity, pixels; the error of a depth grows with its square. 0: none.",
        ge=0,
        le=10,
    )
    baseline: float = setting(0.05, "Distance between the two imagers, meters.", gt=0, le=1)
    dropouts: float = setting(0.0, "Share of pixels without a value (NaN; `16UC1`: 0).", ge=0, le=1)
    encoding: Literal["32FC1", "16UC1"] = setting(
        "32FC1", "Encoding of the images: meters, or millimeters like the D435's driver."
    )

    @model_validator(mode="after")
    def _sees(self) -> CameraSection:
        if self.nearest >= self.farthest:
            raise ValueError("nearest must be less than farthest")
        return self


class SimSection(Section):
    """The simulation of a mobile base, by default the R1's, in the physics engine DART."""

    enabled: bool = setting(False, "Whether the worker `sim` runs.")
    plan: _Description = setting(
        "apartment", "`apartment`, `office`, `lab`, `hall`, `tables`, `two_storeys`, or a file (plan, map, image)."
    )
    resolution: float = setting(0.05, "Meters per pixel of a plan that is an image.", gt=0, le=10)
    robot: _Description = setting("r1", "`r1`, `r1_gazebo`, `ikart_v1`, or a file that describes another robot.")
    start: tuple[float, float, float] | None = setting(
        None, "The robot's start pose: x, y (meters), direction (degrees); empty: from the plan."
    )
    people: bool = setting(True, "Whether the people in the plan walk about.")
    speed: float | Literal["max", "step"] = setting(
        1.0,
        "`1.0`: real time, or a multiple of it; `max`: as fast as possible; `step`: only when a client requests a step."
        " With any value but 1, the simulation publishes `/clock`; then set `clock.source` to `sim`.",
    )
    seed: int = setting(0, "Seed of all noise: the same seed and commands give the same run.", ge=0)
    drive: Literal["velocity", "wheels"] = setting(
        "velocity",
        "`velocity`: the simulator subscribes to `/cmd_vel` and publishes odometry; `wheels`: BaseControl does both.",
    )
    names: Literal["usual", "r1"] = setting(
        "usual",
        "Names of topics and frames: `usual`: `/scan`, `/odom`, `base_link`; `r1`: the robot's own, `/laser`,"
        " `/odometry`, `mobile_base_body_link`.",
    )
    yarp: _Prefix = setting("", "Prefix of the YARP ports: `/cer`, `/SIM_CER_ROBOT`; empty: no ports.")
    part: _Part = setting(
        "mobile_base", "Name of the wheels' control board in YARP ports: `/cer/mobile_base` with `yarp: /cer`."
    )
    view: float = setting(0.0, "Published pictures of the floor (`Image`) per second; 0: none.", ge=0, le=10)
    laser: LaserSection = subsection(LaserSection, "The laser.")
    camera: CameraSection = subsection(CameraSection, "The depth camera.")
    encoders: EncodersSection = subsection(EncodersSection, "Errors of the encoders.")

    @field_validator("speed")
    @classmethod
    def _is_a_speed(cls, value: float | str) -> float | str:
        if isinstance(value, float) and not 0.01 <= value <= 1000:
            raise ValueError("a speed is 0.01 to 1000, `max` or `step`")
        return value

    @property
    @override
    def driven(self) -> tuple[tuple[str, str], ...]:
        return ((WHEEL_COMMAND, JOINTS),) if self.drive == "wheels" else ()

    @override
    def mistakes(self, config: Any) -> Iterable[Mistake]:
        from sim.environment import ready

        shipped = self.plan in ready("plans") and self.robot in ready("robots")
        if shipped and not self.start and not self.encoders.scale:
            return ()
        from sim.fitting import mistakes  # imports numpy

        return mistakes(self.plan, self.resolution, self.robot, self.start, self.encoders.scale, people=self.people)

    @override
    def named_files(self) -> Iterator[Path]:
        if isinstance(self.robot, Path):
            yield self.robot
        if isinstance(self.plan, Path):
            from sim.plan import files_of_plan  # imports numpy

            yield from files_of_plan(self.plan)

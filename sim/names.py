"""Names of topics and frames: the usual ones, or the R1's own."""

from __future__ import annotations

from dataclasses import dataclass

from sim.robot import Robot


@dataclass(frozen=True)
class Names:
    """What is called how."""

    scan: str = "/scan"
    odometry: str = "/odom"
    battery: str = "/battery_state"
    joints: str = "/joint_states"
    truth: str = "/ground_truth"
    bumper: str = "/bumper"
    view: str = "/sim/view"
    velocity: str = "/cmd_vel"
    wheels: str = "/wheel_command"
    odom_frame: str = "odom"
    map_frame: str = "map"
    base_frame: str = "base_link"
    laser_frame: str = "laser"


def names_of(kind: str, robot: Robot) -> Names:
    """The names that the configuration's ``sim.names`` means."""
    if kind == "usual":
        return Names()
    return Names(
        scan="/laser",
        odometry="/odometry",
        battery="/battery_status",
        base_frame=robot.frames.base,
        laser_frame=robot.frames.laser,
    )

"""Checks without DART that the plan, the robot and the start pose of the section ``sim`` fit together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from bridge.config.sections.section import Mistake
from sim import pieces, robot
from sim.environment import SimError
from sim.plan import Plan, Pose, load_plan
from sim.robot import RobotDescription


def mistakes(
    plan: str | Path,
    resolution: float,
    robot_name: str | Path,
    start: Pose | None,
    scale: Sequence[float],
    *,
    people: bool,
) -> Iterator[Mistake]:
    """Yield the keys of the section with which the simulation would not start, and the reasons; see `SimSection`."""
    try:
        description = robot.load(robot_name)
    except SimError as err:
        yield ("robot",), str(err)
        return
    if reason := wrong_scale(scale, description):
        yield ("encoders", "scale"), reason
    try:
        building = load_plan(plan, resolution)
    except SimError as err:
        yield ("plan",), str(err)
        return
    if reason := wrong_start(start, building, description, people=people):
        yield ("start",) if start else ("plan",), reason


def wrong_scale(scale: Sequence[float], description: RobotDescription) -> str:
    """Return why the encoders' errors do not fit the robot, "" if they do."""
    count, wheels = len(scale), description.wheels.names
    if count in (0, len(wheels)):
        return ""
    found = "1 value" if count == 1 else f"{count} values"
    return f"has {found}, and needs {len(wheels)}, one for each wheel of {description.name}: {', '.join(wheels)}"


def wrong_start(start: Pose | None, plan: Plan, description: RobotDescription, *, people: bool) -> str:
    """Return why the robot cannot start at its start pose, "" if it can."""
    floor = plan.floors[plan.first]
    x, y, _ = start or floor.start
    if max(abs(x), abs(y)) > floor.reach:
        return f"{x:.2f}, {y:.2f} is beyond the ground of the plan {plan.name}, {floor.reach:.0f} m from the origin"
    reason = pieces.occupant(pieces.at_start(floor, people=people), description.body, x, y)
    return f"{reason}; it needs {description.body.radius:.2f} m of room on all sides" if reason else ""

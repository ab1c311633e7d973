"""A configuration with which the simulation cannot start is refused when it is loaded."""

# ruff: noqa: E501  expected texts are written as they appear

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bridge.config.document import ConfigError
from bridge.config.load import load, loads
from sim.environment import SimError
from sim.section import EncodersSection, SimSection
from sim.simulation import Simulation

ROOM = "walls: [[[0, 0], [6, 0], [6, 4], [0, 4], [0, 0]]]\n"
ENCODERS = "one for each wheel of r1: mobile_base_l_wheel_joint, mobile_base_r_wheel_joint"
PLANS = (
    "is neither a file nor one of the plans that come with Midspan: apartment, hall, lab, office, tables, two_storeys"
)


@pytest.mark.parametrize(
    ("section", "key", "text"),
    [
        ("encoders: {scale: [0.1]}", "encoders.scale", f"has 1 value, and needs 2, {ENCODERS}"),
        ("encoders: {scale: [0.1, 0.1, 0.1]}", "encoders.scale", f"has 3 values, and needs 2, {ENCODERS}"),
        ("start: [1000, 0, 0]", "start", "1000.00, 0.00 is beyond the ground of the plan apartment, 60 m from the origin"),
        ("start: [0, 3, 0]", "start", "the robot cannot stand at 0.00, 3.00: a wall is there; it needs 0.21 m of room on all sides"),
        ("start: [0, 3]", "start", "has 2 values, and needs exactly 3: The robot's start pose: x, y (meters), direction (degrees)"),
        ("plan: apartmnt", "plan", f"'apartmnt' {PLANS}"),
        ("robot: r2", "robot", "'r2' is neither a file nor one of the robots that come with Midspan: ikart_v1, r1, r1_gazebo"),
        ("laser: {nearest: 2, farthest: 2}", "laser", "nearest must be less than farthest"),
        ("camera: {at: [0, 0, 1100]}", "camera.at[2]", "input should be less than or equal to 10, not 1100"),
    ],
)  # fmt: skip
def test_values_with_which_the_simulation_cannot_start_are_refused(section: str, key: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        loads(f"sim: {{enabled: true, {section}}}", Path("m.yaml"))
    place, _, found = str(caught.value).partition(f" sim.{key}: ")
    assert (place[:9], found) == ("m.yaml:1:", text)


@pytest.mark.parametrize(
    "section",
    [
        "start: [2, 2, 90]",
        "encoders: {scale: [0.1, 0.1]}",
        "robot: ikart_v1, encoders: {scale: [0.1, 0.1, 0.1]}",
        "plan: hall, start: [0, 0, 0]",
    ],
)
def test_values_that_fit_the_plan_and_the_robot_are_accepted(section: str) -> None:
    assert loads(f"sim: {{enabled: true, {section}}}")


def test_a_section_that_is_off_is_not_compared_with_its_files() -> None:
    assert loads("sim: {start: [1000, 0, 0]}")


def test_files_are_relative_to_the_configuration_and_checked(tmp_path: Path) -> None:
    (tmp_path / "room.yaml").write_text(f"{ROOM}start: [1, 1, 0]\n")
    file = tmp_path / "m.yaml"
    file.write_text("sim: {enabled: true, plan: room.yaml}")
    config = load(file)
    assert config.section(SimSection).plan == tmp_path / "room.yaml"
    assert Simulation(config.section(SimSection)).plan.name == "room"
    for text, problem in (
        (f"{ROOM}start: [0, 0, 0]\n", "sim.plan: the robot cannot stand at 0.00, 0.00: a wall is there"),
        ("wals: []\n", "sim.plan: .*room.yaml:1:1: wals: unknown key 'wals'"),
    ):
        (tmp_path / "room.yaml").write_text(text)
        with pytest.raises(ConfigError, match=problem):
            load(file)
    (tmp_path / "room.yaml").unlink()
    with pytest.raises(ConfigError, match=r"sim\.plan: no such file or folder: "):
        load(file)


@pytest.mark.parametrize(
    ("section", "text"),
    [
        (SimSection(start=(1000.0, 0.0, 0.0)), "start pose: 1000.00, 0.00 is beyond the ground of the plan apartment"),
        (SimSection(encoders=EncodersSection(scale=(0.1,))), "sim.encoders.scale has 1 value, and needs 2"),
    ],
)
def test_a_simulation_without_a_daemon_refuses_the_same(section: SimSection, text: str) -> None:
    with pytest.raises(SimError, match=text):
        Simulation(section)


def test_a_robot_can_start_on_the_ground_around_the_plan() -> None:
    config: Any = loads("sim: {enabled: true, start: [-1, -1, 0]}")
    assert config.sim.start == (-1.0, -1.0, 0.0)

"""Topics that move a robot, which are left out when a bag is played."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.bags.play.topics import CommandTopics
from bridge.config.load import load

JOINTS, TWIST = "sensor_msgs/msg/JointState", "geometry_msgs/msg/Twist"
_CONFIG = """
modules:
  base_control: {wheel_command: /wheels, inputs: [{name: pad, joy: [/pad]}]}
  control_boards: {boards: [{remote: /cer/arm, command: /arm/go}]}
routing:
  rules:
    - {topic: /gripper/force, to: ros1, priority: command}
    - {topic: /teleop/drive, to: ros1, rename: /base/cmd_drive}
    - {topic: /arm/wish, rename: /arm/command}
    - {topic: /denied/*, to: ros1, deny: true}
    - {topic: /cmd_*, from: ros1, rename: /state/*}
"""


@pytest.fixture
def moving(tmp_path: Path) -> CommandTopics:
    file = tmp_path / "midspan.yaml"
    file.write_text(_CONFIG)
    return CommandTopics(load(file))


@pytest.mark.parametrize(
    ("name", "type_name"),
    [
        ("/turtle/drive", TWIST),
        ("/move_base/goal", "move_base_msgs/msg/MoveBaseActionGoal"),
        ("/move_base/cancel", "actionlib_msgs/msg/GoalID"),
        ("/goal_pose", "geometry_msgs/msg/PoseStamped"),
        ("/wheels", JOINTS),
        ("/pad", "sensor_msgs/msg/Joy"),
        ("/arm/go", JOINTS),
        ("/wheel_command", JOINTS),
        ("/arm/command", "std_msgs/msg/Float64"),
        ("/ackermann_cmd", "ackermann_msgs/msg/AckermannDriveStamped"),
        ("/gripper/force", "std_msgs/msg/Float64"),
        ("/teleop/drive", "ackermann_msgs/msg/AckermannDriveStamped"),
        ("/arm/wish", "std_msgs/msg/Float64"),
        ("/teleop/twist", TWIST),
    ],
)
def test_topics_that_move_a_robot_are_recognized(name: str, type_name: str, moving: CommandTopics) -> None:
    assert moving.has(name, type_name)


@pytest.mark.parametrize(
    ("name", "type_name"),
    [
        ("/joint_states", JOINTS),
        ("/odom", "nav_msgs/msg/Odometry"),
        ("/state/speed", "std_msgs/msg/Float64"),
        ("/pose", "geometry_msgs/msg/PoseStamped"),
        ("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped"),
    ],
)
def test_state_topics_are_played(name: str, type_name: str, moving: CommandTopics) -> None:
    assert not moving.has(name, type_name)

"""Names that are legal in only one ROS version are converted for the other."""

from __future__ import annotations

import pytest

from bridge.messages.definitions import names

TYPES = [
    ("my_msgs/Plain", "my_msgs/msg/Plain"),
    ("my_msgs/my_type", "my_msgs/msg/MyType"),
    ("tf/tfMessage", "tf/msg/TfMessage"),
    ("My_Msgs/X_Y", "my_msgs/msg/XY"),
]


@pytest.mark.parametrize(("ros1", "ros2"), TYPES)
def test_ros1_types_get_legal_names_in_ros2(ros1: str, ros2: str):
    assert names.legal_type(ros1) == ros2
    assert ros2 in names.ros2_candidates(ros1)


def test_fields_stay_distinct():
    given = ["D", "d", "two__parts", "_lead", "trail_", "CamelCase", "ok", "OK", "Ok", "ok_2"]
    expected = ["d_2", "d", "two_parts", "lead", "trail", "camelcase", "ok", "ok_3", "ok_4", "ok_2"]
    assert list(names.legal_fields(given).values()) == expected


def test_constants_are_upper_case():
    assert names.legal_constants(["debug", "WARN_1", "aB__c", "warn_1"]) == {
        "debug": "DEBUG",
        "WARN_1": "WARN_1",
        "aB__c": "AB_C",
        "warn_1": "WARN_1_2",
    }


def test_packages_named_msgs_and_interfaces_are_tried_for_each_other():
    assert "my_interfaces/msg/A" in names.ros2_candidates("my_msgs/A")
    assert "my_msgs/A" in names.ros1_candidates("my_interfaces/msg/A")
    assert names.ros1_candidates("my_msgs/srv/A_Request") == []


@pytest.mark.parametrize("name", ["a/b/c", "../x/Y", "std_msgs", "std_msgs/", "std_msgs/String\n", "/etc/passwd"])
def test_invalid_ros1_names_are_refused(name: str):
    assert not names.is_ros1_name(name)


@pytest.mark.parametrize("name", ["a/B", "../msg/Y", "std_msgs/msg", "std_msgs/msg/../X", "std_msgs/foo/X"])
def test_invalid_ros2_names_are_refused(name: str):
    assert not names.is_ros2_name(name)

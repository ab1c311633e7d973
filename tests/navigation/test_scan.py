"""Conversion of ROS and YARP scans."""

import math

import numpy as np
import pytest

from navigation.scan import ScanError, clean_ranges, is_blind, of_ros, of_yarp
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.sig.vector import Vector


def test_scans_of_ros_and_yarp_are_converted():
    message = {"angle_min": -1.0, "angle_increment": 0.5, "range_min": 0.0, "range_max": 5.0, "ranges": [1.0, 2.0]}
    turn = of_ros(message, 7)
    assert (turn.time_ns, turn.first, turn.step, turn.nearest) == (7, -1.0, 0.5, 1e-3)
    with pytest.raises(ScanError, match="by 0 rad"):
        of_ros({**message, "angle_increment": 0.0}, 7)
    with pytest.raises(ScanError, match="more than a full circle"):
        of_ros({**message, "angle_increment": 6.0}, 7)
    with pytest.raises(ScanError, match="measures from"):
        of_ros({**message, "range_max": math.nan}, 7)
    scan = LaserScan2D(angle_min=0.0, angle_max=360.0, range_min=0.1, range_max=10.0, scans=Vector([1.0] * 4))
    turn = of_yarp(scan, 7)
    assert turn.step == pytest.approx(math.pi / 2)


def test_ranges_below_the_minimum_are_unknown_and_the_maximum_is_not_an_echo():
    message = {
        "angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.2, "range_max": 5.0,
        "ranges": [0.0, 0.1, 0.2, 4.9, 5.0, 6.0, math.inf, math.nan, -math.inf],
    }  # fmt: skip
    nan, inf = math.nan, math.inf
    ranges = clean_ranges(of_ros(message, 7))
    np.testing.assert_equal(ranges, np.array([nan, nan, 0.2, 4.9, inf, inf, inf, nan, nan]))


@pytest.mark.parametrize(
    ("ranges", "blind"),
    [
        ([math.nan] * 2, True),
        ([0.0] * 2, True),
        ([0.1, math.nan], True),
        ([0.0, 0.2], False),
        ([0.0, -math.inf], False),
        ([math.inf] * 2, False),
    ],
)
def test_a_laser_without_any_valid_range_is_blind(ranges, blind):
    message = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.2, "range_max": 5.0, "ranges": ranges}
    assert is_blind(of_ros(message, 7)) is blind

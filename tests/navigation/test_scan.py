"""Scans of ROS and of YARP, as modules take them."""

import math

import numpy as np
import pytest

from navigation.scan import ScanError, believed, is_blind, of_ros, of_yarp
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.sig.vector import Vector


def test_scans_of_ros_and_yarp():
    message = {"angle_min": -1.0, "angle_increment": 0.5, "range_min": 0.0, "range_max": 5.0, "ranges": [1.0, 2.0]}
    made = of_ros(message, 7)
    assert (made.time_ns, made.first, made.step, made.nearest) == (7, -1.0, 0.5, 1e-3)
    with pytest.raises(ScanError, match="by 0 rad"):
        of_ros({**message, "angle_increment": 0.0}, 7)
    with pytest.raises(ScanError, match="more than once"):
        of_ros({**message, "angle_increment": 6.0}, 7)
    with pytest.raises(ScanError, match="measures from"):
        of_ros({**message, "range_max": math.nan}, 7)
    scan = LaserScan2D(angle_min=0.0, angle_max=360.0, range_min=0.1, range_max=10.0, scans=Vector([1.0] * 4))
    made = of_yarp(scan, 7)
    assert made.step == pytest.approx(math.pi / 2)


def test_too_near_is_not_known_and_the_farthest_is_no_echo():
    message = {
        "angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.2, "range_max": 5.0,
        "ranges": [0.0, 0.1, 0.2, 4.9, 5.0, 6.0, math.inf, math.nan, -math.inf],
    }  # fmt: skip
    nan, inf = math.nan, math.inf
    found = believed(of_ros(message, 7))
    np.testing.assert_equal(found, np.array([nan, nan, 0.2, 4.9, inf, inf, inf, nan, nan]))


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
def test_a_laser_is_blind_that_says_nothing_all_round(ranges, blind):
    message = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.2, "range_max": 5.0, "ranges": ranges}
    assert is_blind(of_ros(message, 7)) is blind

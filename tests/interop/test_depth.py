"""The simulator's depth camera, read by real rospy and rclpy programs, and by a YARP reader of the robot's port."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim import messages
from tests.peers.daemon.deployment import Deployment
from tests.peers.yarp.programs import Names
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.pythonic import Reader
from yarp_compat.sig.image import ImageFloat

AHEAD = 9.95 - 0.5 - 0.1
"""Meters from the camera to the wall of the hall."""


@pytest.mark.thorough
def test_every_side_receives_the_distance_of_the_wall(tmp_path: Path) -> None:
    names = Names()
    camera = {"rate": 5.0, "width": 32, "height": 24, "noise": 0.0, "pitch": 0.0}
    try:
        with Deployment(tmp_path) as site:
            site.start(
                yarp={"enabled": True, "nameserver": "site", "address": names.endpoint, "poll": 0.1},
                sim={"enabled": True, "plan": "hall", "start": [0.5, 0.0, 0.0], "yarp": "/cer", "camera": camera},
            )
            rospy, rclpy = site.ros1(), site.ros2()
            pictures = rospy.subscribe(messages.DEPTH, "sensor_msgs/Image")
            infos = rospy.subscribe(messages.DEPTH_INFO, "sensor_msgs/CameraInfo")
            clouds = rclpy.subscribe(messages.DEPTH_POINTS, "sensor_msgs/PointCloud2")
            frames = rclpy.subscribe("/tf_static", "tf2_msgs/TFMessage", latched=True)
            picture, info = rospy.wait(pictures, 2, 40)[-1], rospy.wait(infos, 1, 40)[-1]
            depths = array(picture["data"], "<f4").reshape(24, 32)
            assert (picture["encoding"], picture["header"]["frame_id"]) == ("32FC1", messages.OPTICAL_FRAME)
            assert depths[11, 16] == pytest.approx(AHEAD, abs=0.05)
            assert (info.get("k") or info["K"])[2] == 15.5
            cloud = rclpy.wait(clouds, 1, 40)[-1]
            points = array(cloud["data"], "<f4").reshape(24, 32, 3)
            assert points[11, 16, 2] == pytest.approx(AHEAD, abs=0.05)
            reported = {item["child_frame_id"] for item in rclpy.wait(frames, 1, 40)[-1]["transforms"]}
            assert reported >= {messages.CAMERA_FRAME, messages.OPTICAL_FRAME}
            port = "/cer/depthCamera/depthImage:o"
            until(lambda: connections.exists(names.client, port), "the robot's port exists", 40)
            with Reader("/test/depth:i", naming=names.client) as reader:
                connections.connect(names.client, port, "/test/depth:i")
                received = until(reader.read_now, "a picture arrives", 40)
            seen = received.to(ImageFloat).numpy()
            assert seen.shape == (24, 32)
            np.testing.assert_allclose(seen[11, 16], AHEAD, atol=0.05)
            site.stop_programs()
    finally:
        names.stop()


def array(data: Any, kind: str) -> np.ndarray:
    """Return the array in a message, in any peer's spelling."""
    raw = base64.b64decode(data) if isinstance(data, str) else bytes(data)
    return np.frombuffer(raw, kind)

"""A real rclpy program publishes a cloud, rospy receives and saves the layer, and rclpy gets the stored map.

The rclpy program also saves Mapper2D's map through slam_toolbox's service.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from navigation.mapper3d.octomaps import cloud_message
from tests.interop.test_maps import call
from tests.peers.daemon.deployment import Deployment
from tests.support.wait import until
from yarp_compat.octree import OcTree


def test_a_cloud_of_ros2_is_a_layer_on_ros1(deployment: Deployment) -> None:
    section = {"enabled": True, "clouds": ["/camera/points"], "map_frame": "odom", "layer": {"period": 0.1}}
    flat = {"enabled": True, "map_frame": "odom", "laser": [0, 0, 0]}
    deployment.start(modules={"mapper3d": section, "map2d_server": {"enabled": True}, "mapper2d": flat})
    ros2, ros1 = deployment.ros2(), deployment.ros1()
    cloud = ros2.advertise("/camera/points", "sensor_msgs/PointCloud2")
    static = ros2.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True)
    stands = {"translation": {"x": 0.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    frame = {"header": {"frame_id": "odom"}, "child_frame_id": "base_link", "transform": stands}
    ros2.publish(static, {"transforms": [frame]})
    layers = ros1.subscribe("/mapper3d/layer", "nav_msgs/OccupancyGrid")
    x, y = np.meshgrid(np.arange(0.5, 2.5, 0.04), np.arange(-0.9, 0.9, 0.04))
    floor = np.stack((x, y, np.full(x.shape, -0.01)), -1).reshape(-1, 3)
    top = floor[(np.abs(floor[:, 0] - 2.0) < 0.3) & (np.abs(floor[:, 1]) < 0.4)] + np.array([0.0, 0.0, 0.75])
    points = np.concatenate([floor, top]).astype(np.float32)
    message: dict[str, Any] = cloud_message({"frame_id": "base_link"}, points)
    message["data"] = message["data"].tolist()

    def layer() -> bool:
        ros2.publish(cloud, message)
        result = ros1.wait(layers, 1, 1.0, 0)
        return bool(result) and value(result[-1], 2.0, 0.0) == 100 and value(result[-1], 1.0, 0.8) == 0

    until(layer, "the table is in the layer", 60, 0.1)
    saved = "3D map map and layer layer saved into the store."
    assert call(ros1, "/mapper3d/save", "std_srvs/Trigger")["message"] == saved
    got = call(ros2, "/maps3d/map/octomap_full", "octomap_msgs/GetOctomap", waits=False)["map"]
    tree = OcTree.from_full(np.array(got["data"], np.int8).tobytes(), got["resolution"])
    assert (got["header"]["frame_id"], tree.search(2.0, 0.0, 0.74) > 0) == ("map", True)
    scans = ros2.advertise("/scan", "sensor_msgs/LaserScan")
    fan = {"angle_min": -3.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 10.0, "ranges": [2.0] * 60}

    def saves() -> bool:
        ros2.publish(scans, {"header": {"frame_id": "laser"}, **fan})
        request = {"name": {"data": "floor"}}
        reply = call(ros2, "/slam_toolbox/save_map", "slam_toolbox/SaveMap", waits=False, **request)
        return bool(reply["result"] == 0)

    until(saves, "the map is saved", 60, 0.1)
    assert {file.suffix for file in deployment.folder.rglob("mapper2d/maps/floor.*")} >= {".yaml", ".pgm"}


def value(message: dict[str, Any], x: float, y: float) -> int:
    """Return the value of a layer's cell, or -1 outside of the layer."""
    info, origin = message["info"], message["info"]["origin"]["position"]
    column, row = int((x - origin["x"]) / info["resolution"]), int((y - origin["y"]) / info["resolution"])
    inside = 0 <= column < info["width"] and 0 <= row < info["height"]
    return int(message["data"][row * info["width"] + column]) if inside else -1

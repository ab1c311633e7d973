"""A stand-in for ROS 1's map_server: one map from a YAML file, latched on /map.

Like the real one (navigation 1.17.3), it publishes /map_metadata and serves /static_map and /change_map, but never
changes the map.

Usage: map_server.py apartment.yaml
"""

import sys
from pathlib import Path

import rospy
import yaml
from nav_msgs.msg import MapMetaData, OccupancyGrid
from nav_msgs.srv import GetMap, GetMapResponse, LoadMap, LoadMapResponse


def pixels(file):
    """Return the width, height and bytes of a binary PGM file."""
    data = file.read_bytes()
    parts, remainder = [], data
    while len(parts) < 4:
        line, _, remainder = remainder.partition(b"\n")
        parts += line.partition(b"#")[0].split()
    return int(parts[1]), int(parts[2]), remainder


file = Path(sys.argv[1])
meta = yaml.safe_load(file.read_text(encoding="utf-8"))
width, height, gray = pixels(file.with_name(meta["image"]))
rospy.init_node("map_server")
grid = OccupancyGrid()
grid.header.frame_id = "map"
grid.header.stamp = rospy.Time.now()
grid.info.resolution, grid.info.width, grid.info.height = meta["resolution"], width, height
grid.info.origin.position.x, grid.info.origin.position.y = meta["origin"][:2]
grid.info.origin.orientation.w = 1.0
for row in reversed(range(height)):
    for value in gray[row * width : (row + 1) * width]:
        dark = (255 - value) / 255.0
        grid.data.append(100 if dark > meta["occupied_thresh"] else 0 if dark < meta["free_thresh"] else -1)
publisher = rospy.Publisher("map", OccupancyGrid, queue_size=1, latch=True)
metadata = rospy.Publisher("map_metadata", MapMetaData, queue_size=1, latch=True)
rospy.Service("static_map", GetMap, lambda _request: GetMapResponse(grid))
rospy.Service("change_map", LoadMap, lambda _request: LoadMapResponse(grid, LoadMapResponse.RESULT_UNDEFINED_FAILURE))
metadata.publish(grid.info)
publisher.publish(grid)
rospy.spin()

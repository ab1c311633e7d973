"""A stand-in for ROS 1's map_server: one map of a YAML file, latched on /map.

As the real one (navigation 1.17.3) it has /map_metadata and serves /static_map and /change_map; it changes nothing.

ros1_map_server.py apartment.yaml
"""

import sys
from pathlib import Path

import rospy
import yaml
from nav_msgs.msg import MapMetaData, OccupancyGrid
from nav_msgs.srv import GetMap, GetMapResponse, LoadMap, LoadMapResponse


def pixels(file):
    """Width, height and bytes of a binary PGM."""
    words = file.read_bytes()
    parts, rest = [], words
    while len(parts) < 4:
        line, _, rest = rest.partition(b"\n")
        parts += line.partition(b"#")[0].split()
    return int(parts[1]), int(parts[2]), rest


file = Path(sys.argv[1])
said = yaml.safe_load(file.read_text())
width, height, gray = pixels(file.with_name(said["image"]))
rospy.init_node("map_server")
grid = OccupancyGrid()
grid.header.frame_id = "map"
grid.header.stamp = rospy.Time.now()
grid.info.resolution, grid.info.width, grid.info.height = said["resolution"], width, height
grid.info.origin.position.x, grid.info.origin.position.y = said["origin"][:2]
grid.info.origin.orientation.w = 1.0
for row in reversed(range(height)):
    for value in gray[row * width : (row + 1) * width]:
        dark = (255 - value) / 255.0
        grid.data.append(100 if dark > said["occupied_thresh"] else 0 if dark < said["free_thresh"] else -1)
publisher = rospy.Publisher("map", OccupancyGrid, queue_size=1, latch=True)
metadata = rospy.Publisher("map_metadata", MapMetaData, queue_size=1, latch=True)
rospy.Service("static_map", GetMap, lambda _request: GetMapResponse(grid))
rospy.Service("change_map", LoadMap, lambda _request: LoadMapResponse(grid, LoadMapResponse.RESULT_UNDEFINED_FAILURE))
metadata.publish(grid.info)
publisher.publish(grid)
rospy.spin()

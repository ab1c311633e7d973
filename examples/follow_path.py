"""Store a path through several locations on the map server, and follow it without intermediate stops.

python follow_path.py tour kitchen hall bedroom
"""

import sys

import yarp_compat as yarp

name, *places = sys.argv[1:]
with yarp.Navigation2DClient() as robot:
    path = yarp.Map2DPath(description="stored by follow_path.py")
    for place in places:
        location = yarp.Map2DLocation()
        if not robot.getLocation(place, location):
            sys.exit(f"unknown location {place!r}")
        path.push_back(location)
    robot.storePath(name, path)
    print(f"{name}: {path.size()} places, {path.getLength():.1f} m")
    if not robot.followPath(path):
        sys.exit("the planner does not support paths")
    end = robot.wait()
print(yarp.statusToString(end))
sys.exit(end is not yarp.navigation_status_goal_reached)

"""Sends a robot to a location with a navigation client, as tutorials do: options, views, a loop, and the end."""

import sys

import yarp

yarp.Network.init()
if not yarp.Network.checkNetwork():
    print("the name server does not answer")
    raise SystemExit

options = yarp.Property()
options.put("device", sys.argv[1])
options.put("local", "/navigate")
options.put("navigation_server", "/nav")
options.put("map_locations_server", "/maps")
options.put("localization_server", "/loc")

device = yarp.PolyDriver(options)
if not device.isValid():
    print("Cannot open the device!")
    raise SystemExit

robot = device.viewINavigation2D()
places = device.viewIMap2D()
where = device.viewILocalization2D()

position = yarp.Map2DLocation()
names = yarp.SVector()
if not where.getCurrentPosition(position) or not places.getLocationsList(names):
    print("the robot reports no position")
    raise SystemExit
print(f"at {position.x:.1f} {position.y:.1f} of {position.map_id}, knows {' '.join(sorted(names))}")
if robot.gotoTargetByLocationName("nowhere"):
    print("it went nowhere")
if robot.gotoTargetByLocationName("kitchen"):
    while robot.getNavigationStatus() == yarp.navigation_status_moving:
        yarp.delay(0.01)
    print("reached" if robot.getNavigationStatus() == yarp.navigation_status_goal_reached else "not reached")
print("closed", device.close(), device.isValid())
yarp.Network.fini()

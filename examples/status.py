"""Print a robot's navigation status, its pose and the stored places: the smallest client.

python status.py
"""

import yarp_compat as yarp

with yarp.Navigation2DClient() as robot:
    print(yarp.statusToString(robot.getNavigationStatus()), robot.getNameOfCurrentTarget() or "-")
    position = yarp.Map2DLocation()
    if robot.getCurrentPosition(position):
        print(f"{position.map_id} {position.x:.2f} {position.y:.2f} {position.theta:.0f}")
    else:
        print("position unknown")
    places: list[str] = []
    robot.getLocationsList(places)
    print("places:", *sorted(places))

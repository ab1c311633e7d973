"""Ask a robot what it does and where it is: the smallest client.

python status.py
"""

import yarp_compat as yarp

with yarp.Navigation2DClient() as robot:
    print(yarp.statusToString(robot.getNavigationStatus()), robot.getNameOfCurrentTarget() or "-")
    here = yarp.Map2DLocation()
    print(f"{here.map_id} {here.x:.2f} {here.y:.2f} {here.theta:.0f}" if robot.getCurrentPosition(here) else "where?")
    places: list[str] = []
    robot.getLocationsList(places)
    print("places:", *sorted(places))

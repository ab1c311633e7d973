"""Go to a location, unaware of which framework plans the way: the client of the paper's supplement, in YARP's words.

    python goto_location_yarp.py kitchen

Needs `yarp_compat` alone, and the name server of `yarp.conf`. Whoever plans answers at the same ports: a module of
Midspan, a YARP device, ROS 1's move_base or Nav2. With YARP's own bindings the interface is that of the device
`navigation2D_nwc_yarp`; the calls below are the same.
"""

import sys
import time

import yarp_compat as yarp

ENDS = (
    yarp.navigation_status_goal_reached,
    yarp.navigation_status_aborted,
    yarp.navigation_status_failing,
    yarp.navigation_status_error,
    yarp.navigation_status_idle,
)


def main(name: str) -> int:
    here, there = yarp.Map2DLocation(), yarp.Map2DLocation()
    with yarp.Navigation2DClient("/navigation2D_nws_yarp", "/map2D_nws_yarp", "/localization2D_nws_yarp") as robot:
        if not robot.gotoTargetByLocationName(name):
            print(f"{name}: there is no such place, or nobody drives there")
            return 1
        robot.getAbsoluteLocationOfCurrentTarget(there)
        while (status := robot.getNavigationStatus()) not in ENDS:
            if robot.getCurrentPosition(here):
                print(f"{yarp.statusToString(status)}: at {here.x:.2f} {here.y:.2f}, to {there.x:.2f} {there.y:.2f}")
            time.sleep(0.2)
    print(yarp.statusToString(status))
    return status is not yarp.navigation_status_goal_reached


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

"""Go to a location with YARP, whichever framework the planner belongs to: the client of the paper's supplement.

    python goto_location_yarp.py kitchen

Needs only `yarp_compat`, and the name server of `yarp.conf`. The ports are the same for every planner: a module of
Midspan, a YARP device, ROS 1's move_base or Nav2. With YARP's own bindings, open the device `navigation2D_nwc_yarp`;
the calls below stay the same.
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
    position, target = yarp.Map2DLocation(), yarp.Map2DLocation()
    with yarp.Navigation2DClient("/navigation2D_nws_yarp", "/map2D_nws_yarp", "/localization2D_nws_yarp") as robot:
        if not robot.gotoTargetByLocationName(name):
            print(f"{name}: unknown place, or the goal was rejected")
            return 1
        robot.getAbsoluteLocationOfCurrentTarget(target)
        while (status := robot.getNavigationStatus()) not in ENDS:
            if robot.getCurrentPosition(position):
                route = f"at {position.x:.2f} {position.y:.2f}, to {target.x:.2f} {target.y:.2f}"
                print(f"{yarp.statusToString(status)}: {route}")
            time.sleep(0.2)
    print(yarp.statusToString(status))
    return status is not yarp.navigation_status_goal_reached


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

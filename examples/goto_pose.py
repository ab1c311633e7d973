"""Go to a pose on a map or in the robot's own frame, in meters and degrees. Ctrl-C stops the robot.

python goto_pose.py apartment 1.5 2.0 90
python goto_pose.py --relative 0.5 0.0
"""

import argparse
import sys

import yarp_compat as yarp

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--relative", action="store_true", help="X and Y are ahead and to the left of the robot")
parser.add_argument("pose", nargs="+", metavar="MAP X Y THETA | X Y [THETA]")
args = parser.parse_args()

with yarp.Navigation2DClient() as robot:
    if args.relative:
        accepted = robot.gotoTargetByRelativeLocation(*map(float, args.pose))
    else:
        name, *numbers = args.pose
        accepted = robot.gotoTargetByAbsoluteLocation(yarp.Map2DLocation(name, *map(float, numbers)))
    if not accepted:
        sys.exit(f"rejected: {accepted.toString()}")
    try:
        end = robot.wait()
    except KeyboardInterrupt:
        robot.stopNavigation()
        sys.exit("stopped")
print(yarp.statusToString(end))
sys.exit(end is not yarp.navigation_status_goal_reached)

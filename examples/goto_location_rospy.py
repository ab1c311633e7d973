"""Go to a location, unaware of which framework plans the way: for ROS 1, with what comes with it alone.

    python3 goto_location_rospy.py kitchen

Locations are the markers of /map_locations (Midspan's map server), and the goal goes to /move_base, whoever that is: a
move_base, or the door that Midspan opens to another planner.
"""

import sys

import actionlib
import rospy
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from visualization_msgs.msg import Marker, MarkerArray

SECONDS = 60.0
MARKED = "location "


def place(name):
    """A location's pose."""
    known = rospy.wait_for_message("/map_locations", MarkerArray, SECONDS).markers
    places = {m.ns.removeprefix(MARKED): m for m in known if m.ns.startswith(MARKED) and m.type == Marker.ARROW}
    if name not in places:
        sys.exit(f"there is no location {name!r}; there are {', '.join(sorted(places)) or 'none'}")
    return PoseStamped(places[name].header, places[name].pose)


def heard(feedback):
    at = feedback.base_position.pose.position
    print(f"at {at.x:.2f} {at.y:.2f}", flush=True)


def main(name):
    rospy.init_node("goto_location", anonymous=True)
    goal = MoveBaseGoal(place(name))
    goal.target_pose.header.stamp = rospy.Time.now()
    robot = actionlib.SimpleActionClient("/move_base", MoveBaseAction)
    if not robot.wait_for_server(rospy.Duration(SECONDS)):
        sys.exit("nobody plans: there is no /move_base")
    robot.send_goal(goal, feedback_cb=heard)
    robot.wait_for_result()
    reached = robot.get_state() == GoalStatus.SUCCEEDED
    print("reached" if reached else f"not reached: {robot.get_goal_status_text()}")
    return not reached


if __name__ == "__main__":
    sys.exit(main(rospy.myargv(sys.argv)[1]))

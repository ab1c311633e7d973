"""Go to a location with ROS 1's standard packages, whichever framework the planner belongs to.

    python3 goto_location_rospy.py kitchen

Locations are markers on /map_locations (Midspan's map server). The goal is sent to /move_base, which is served by
move_base, or by Midspan for another planner.
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
    """Return a location's pose."""
    markers = rospy.wait_for_message("/map_locations", MarkerArray, SECONDS).markers
    places = {m.ns.removeprefix(MARKED): m for m in markers if m.ns.startswith(MARKED) and m.type == Marker.ARROW}
    if name not in places:
        sys.exit(f"unknown location {name!r}; locations: {', '.join(sorted(places)) or 'none'}")
    return PoseStamped(places[name].header, places[name].pose)


def on_feedback(feedback):
    position = feedback.base_position.pose.position
    print(f"at {position.x:.2f} {position.y:.2f}", flush=True)


def main(name):
    rospy.init_node("goto_location", anonymous=True)
    goal = MoveBaseGoal(place(name))
    goal.target_pose.header.stamp = rospy.Time.now()
    robot = actionlib.SimpleActionClient("/move_base", MoveBaseAction)
    if not robot.wait_for_server(rospy.Duration(SECONDS)):
        sys.exit("no planner: the action /move_base is not available")
    robot.send_goal(goal, feedback_cb=on_feedback)
    robot.wait_for_result()
    reached = robot.get_state() == GoalStatus.SUCCEEDED
    print("reached" if reached else f"not reached: {robot.get_goal_status_text()}")
    return not reached


if __name__ == "__main__":
    sys.exit(main(rospy.myargv(sys.argv)[1]))

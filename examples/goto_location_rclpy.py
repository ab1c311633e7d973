"""Go to a location, unaware of which framework plans the way: for ROS 2.

    python3 goto_location_rclpy.py kitchen

Locations are the markers of /map_locations (Midspan's map server), and the goal goes to /navigate_to_pose, whoever that
is: Nav2, or the door that Midspan opens to another planner.
"""

import sys

import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from visualization_msgs.msg import Marker, MarkerArray

SECONDS = 60.0
MARKED = "location "
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def place(node, name):
    """A location's pose."""
    came = Future()
    node.create_subscription(MarkerArray, "/map_locations", lambda said: came.done() or came.set_result(said), LATCHED)
    rclpy.spin_until_future_complete(node, came, timeout_sec=SECONDS)
    known = came.result().markers if came.done() else sys.exit("nobody says where locations are, on /map_locations")
    places = {m.ns.removeprefix(MARKED): m for m in known if m.ns.startswith(MARKED) and m.type == Marker.ARROW}
    if name not in places:
        sys.exit(f"there is no location {name!r}; there are {', '.join(sorted(places)) or 'none'}")
    return PoseStamped(header=places[name].header, pose=places[name].pose)


def heard(message):
    at = message.feedback.current_pose.pose.position
    print(f"at {at.x:.2f} {at.y:.2f}", flush=True)


def main(name):
    rclpy.init()
    node = rclpy.create_node("goto_location")
    goal = NavigateToPose.Goal(pose=place(node, name))
    robot = ActionClient(node, NavigateToPose, "/navigate_to_pose")
    if not robot.wait_for_server(SECONDS):
        sys.exit("nobody plans: there is no /navigate_to_pose")
    sent = robot.send_goal_async(goal, feedback_callback=heard)
    rclpy.spin_until_future_complete(node, sent)
    if not sent.result().accepted:
        sys.exit("the goal was refused")
    ended = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, ended)
    status, result = ended.result().status, ended.result().result
    node.destroy_node()
    rclpy.shutdown()
    print("reached" if status == GoalStatus.STATUS_SUCCEEDED else f"not reached: {result.error_msg}")
    return status != GoalStatus.STATUS_SUCCEEDED


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

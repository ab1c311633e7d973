"""Go to a location with ROS 2, whichever framework the planner belongs to.

    python3 goto_location_rclpy.py kitchen

Locations are markers on /map_locations (Midspan's map server). The goal is sent to /navigate_to_pose, which is served
by Nav2, or by Midspan for another planner.
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
    """Return a location's pose."""
    received = Future()
    node.create_subscription(
        MarkerArray, "/map_locations", lambda message: received.done() or received.set_result(message), LATCHED
    )
    rclpy.spin_until_future_complete(node, received, timeout_sec=SECONDS)
    if not received.done():
        sys.exit("no locations on /map_locations: start Midspan's map server")
    markers = received.result().markers
    places = {m.ns.removeprefix(MARKED): m for m in markers if m.ns.startswith(MARKED) and m.type == Marker.ARROW}
    if name not in places:
        sys.exit(f"unknown location {name!r}; locations: {', '.join(sorted(places)) or 'none'}")
    return PoseStamped(header=places[name].header, pose=places[name].pose)


def on_feedback(message):
    position = message.feedback.current_pose.pose.position
    print(f"at {position.x:.2f} {position.y:.2f}", flush=True)


def main(name):
    rclpy.init()
    node = rclpy.create_node("goto_location")
    goal = NavigateToPose.Goal(pose=place(node, name))
    robot = ActionClient(node, NavigateToPose, "/navigate_to_pose")
    if not robot.wait_for_server(SECONDS):
        sys.exit("no planner: the action /navigate_to_pose is not available")
    request = robot.send_goal_async(goal, feedback_callback=on_feedback)
    rclpy.spin_until_future_complete(node, request)
    if not request.result().accepted:
        sys.exit("the planner rejected the goal")
    outcome = request.result().get_result_async()
    rclpy.spin_until_future_complete(node, outcome)
    status, result = outcome.result().status, outcome.result().result
    node.destroy_node()
    rclpy.shutdown()
    print("reached" if status == GoalStatus.STATUS_SUCCEEDED else f"not reached: {result.error_msg}")
    return status != GoalStatus.STATUS_SUCCEEDED


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

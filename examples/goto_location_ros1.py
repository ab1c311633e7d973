"""Go to a location as a ROS 1 client on a computer without ROS 1, whichever framework the planner belongs to.

    python3 goto_location_ros1.py kitchen

It does the same as goto_location_rospy.py, with Midspan's own ROS 1 node instead of rospy. Locations are markers on
/map_locations (Midspan's map server). The goal is sent to /move_base, which is served by move_base, or by Midspan for
another planner.
"""

import sys

from bridge.adapters.ros1.program import Ros1Program

SECONDS = 60.0
MARKED = "location "
ARROW = 0  # visualization_msgs/Marker


def place(ros, name):
    """Return a location's pose."""
    message = ros.wait_for_message("/map_locations", "visualization_msgs/MarkerArray", SECONDS)
    if message is None:
        sys.exit("no locations on /map_locations: start Midspan's map server")
    markers = message["markers"]
    places = {m["ns"].removeprefix(MARKED): m for m in markers if m["ns"].startswith(MARKED) and m["type"] == ARROW}
    if name not in places:
        sys.exit(f"unknown location {name!r}; locations: {', '.join(sorted(places)) or 'none'}")
    return {"header": {"frame_id": places[name]["header"]["frame_id"]}, "pose": places[name]["pose"]}


def on_feedback(feedback):
    position = feedback["base_position"]["pose"]["position"]
    print(f"at {position['x']:.2f} {position['y']:.2f}", flush=True)


def main(name):
    with Ros1Program("goto_location") as ros:
        goal = {"target_pose": place(ros, name)}
        robot = ros.action_client("/move_base", "move_base_msgs/MoveBase")
        if not robot.wait_for_server(SECONDS):
            sys.exit("no planner: the action /move_base is not available")
        outcome = robot.send_goal(goal, on_feedback)
    print("reached" if outcome.succeeded else f"not reached: {outcome.text}")
    return not outcome.succeeded


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

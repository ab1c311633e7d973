"""The real tf2_ros.BufferClient of ROS 1, driven by the commands of `tests.peers.peer`; needs the system Python.

``lookup`` target, source, stamp (ns), timeout (s); in the full form target_stamp and fixed too -> pose [stamp, x, y, z,
qx, qy, qz, qw], or error (the exception's name) and text. ``frames`` -> yaml, by the service /tf2_frames. ``server``
seconds -> there.
"""

import json
import sys

import rospy
import tf2_py
import tf2_ros
from tf2_msgs.srv import FrameGraph


def time(ns):
    """Return a time as a rospy type."""
    return rospy.Time(*divmod(ns, 10**9))


def lookup(client, params):
    """Perform one lookup."""
    target, source, stamp = params["target"], params["source"], time(params["stamp"])
    wait = rospy.Duration.from_sec(params["timeout"])
    try:
        if "fixed" in params:
            transform = client.lookup_transform_full(
                target, time(params["target_stamp"]), source, stamp, params["fixed"], wait
            )
        else:
            transform = client.lookup_transform(target, source, stamp, wait)
    except tf2_py.TransformException as err:
        return {"error": type(err).__name__, "text": str(err)}
    v, q = transform.transform.translation, transform.transform.rotation
    return {"pose": [transform.header.stamp.to_nsec(), v.x, v.y, v.z, q.x, q.y, q.z, q.w]}


def main():
    rospy.init_node("buffer_client", disable_signals=True)
    client = tf2_ros.BufferClient("/tf2_buffer_server", timeout_padding=rospy.Duration(20.0))
    for line in sys.stdin:
        params = json.loads(line)
        if params["do"] == "lookup":
            answer = lookup(client, params)
        elif params["do"] == "server":
            answer = {"there": client.wait_for_server(rospy.Duration(params["seconds"]))}
        elif params["do"] == "frames":
            rospy.wait_for_service("/tf2_frames", 30.0)
            answer = {"yaml": rospy.ServiceProxy("/tf2_frames", FrameGraph)().frame_yaml}
        else:
            break
        print(json.dumps({"ok": True, **answer}), flush=True)


if __name__ == "__main__":
    main()

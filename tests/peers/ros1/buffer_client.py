"""The real tf2_ros.BufferClient of ROS 1, driven by the commands of `tests.peers.peer`; needs the system's Python.

``lookup`` target, source, stamp (ns), timeout (s), and, in the full form, target_stamp and fixed -> pose [stamp, x, y,
z, qx, qy, qz, qw], or error (the exception's name) and text. ``frames`` -> yaml, from the service /tf2_frames.
``server`` seconds -> there.
"""

import sys
from pathlib import Path

import rospy
import tf2_py
import tf2_ros
from tf2_msgs.srv import FrameGraph

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.commands import Commands, only_answers, serve


def time(ns):
    """Return a time in nanoseconds as a rospy time."""
    return rospy.Time(*divmod(ns, 10**9))


class Client(Commands):
    """Executes the commands."""

    def __init__(self) -> None:
        super().__init__()
        self.client = tf2_ros.BufferClient("/tf2_buffer_server", timeout_padding=rospy.Duration(20.0))

    def lookup(self, target, source, stamp, timeout, target_stamp=0, fixed=None):
        wait = rospy.Duration.from_sec(timeout)
        try:
            if fixed is not None:
                transform = self.client.lookup_transform_full(
                    target, time(target_stamp), source, time(stamp), fixed, wait
                )
            else:
                transform = self.client.lookup_transform(target, source, time(stamp), wait)
        except tf2_py.TransformException as err:
            return {"error": type(err).__name__, "text": str(err)}
        v, q = transform.transform.translation, transform.transform.rotation
        return {"pose": [transform.header.stamp.to_nsec(), v.x, v.y, v.z, q.x, q.y, q.z, q.w]}

    def server(self, seconds):
        return {"there": self.client.wait_for_server(rospy.Duration(seconds))}

    def frames(self):
        rospy.wait_for_service("/tf2_frames", 30.0)
        return {"yaml": rospy.ServiceProxy("/tf2_frames", FrameGraph)().frame_yaml}


def main():
    answers = only_answers()
    rospy.init_node("buffer_client", disable_signals=True)
    serve(Client(), answers)


if __name__ == "__main__":
    main()

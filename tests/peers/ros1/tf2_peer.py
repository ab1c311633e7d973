"""Runs the cases of `trees` on ROS 1's real tf2 (tf2_py); runs only on the system's Python.

Usage: tf2_peer.py SEED COUNT. It writes results to standard output (marshal): for each lookup of all cases (stamp, x,
y, z, qx, qy, qz, qw), or (name of the exception, its text); after each case, all frames as YAML. tf2 logs rejected
transforms to standard error.
"""

import marshal
import sys
from pathlib import Path

import genpy
import geometry_msgs.msg
import tf2_py

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.ros1 import trees


def stamp_of(ns):
    """Return a time in nanoseconds as a ROS 1 time."""
    return genpy.Time(*divmod(ns, trees.SECOND))


def answer(buffer, step):
    """Return the result of one lookup."""
    try:
        if step[0] == "ask":
            transform = buffer.lookup_transform_core(step[1], step[2], stamp_of(step[3]))
        else:
            transform = buffer.lookup_transform_full_core(
                step[1], stamp_of(step[2]), step[3], stamp_of(step[4]), step[5]
            )
    except Exception as err:
        return type(err).__name__, str(err)
    moved, turned = transform.transform.translation, transform.transform.rotation
    return transform.header.stamp.to_nsec(), moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w


def main():
    answers = []
    message = geometry_msgs.msg.TransformStamped()
    moved, turned = message.transform.translation, message.transform.rotation
    for steps in trees.cases(int(sys.argv[1]), int(sys.argv[2])):
        buffer = tf2_py.BufferCore(genpy.Duration(10.0))
        for step in steps:
            if step[0] == "set":
                message.header.frame_id, message.child_frame_id = step[1], step[2]
                message.header.stamp = stamp_of(step[3])
                moved.x, moved.y, moved.z = step[4]
                turned.x, turned.y, turned.z, turned.w = step[5]
                (buffer.set_transform_static if step[6] else buffer.set_transform)(message, "peer")
            elif step[0] == "clear":
                buffer.clear()
            elif step[0] == "frames":
                answers.append(buffer.all_frames_as_yaml())
            else:
                answers.append(answer(buffer, step))
    sys.stdout.buffer.write(marshal.dumps(answers))


if __name__ == "__main__":
    main()

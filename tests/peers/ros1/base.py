"""A robot's base on ROS 1, which follows ``/cmd_vel`` and publishes ``/tf``; see `base_body` for its output.

Like a real base's driver, it brakes after half a second without a velocity, and it publishes odometry even if the
planner fails. It also publishes ``map`` to ``odom``, in place of a localizer. Runs on the system's Python.
Usage: base.py [--ramp M/S2] [--watchdog S] [--no-odometry]
"""

import math
import sys
from pathlib import Path

import rospy
from geometry_msgs.msg import TransformStamped, Twist
from tf2_msgs.msg import TFMessage

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.sim.base_body import PERIOD, Body, arguments


def transform(parent, child, x, y, yaw):
    message = TransformStamped()
    message.header.frame_id, message.header.stamp, message.child_frame_id = parent, rospy.Time.now(), child
    message.transform.translation.x, message.transform.translation.y = x, y
    message.transform.rotation.z, message.transform.rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return message


def main():
    options = arguments()
    rospy.init_node("base")
    body = Body(options.ramp, options.watchdog)
    frames = rospy.Publisher("tf", TFMessage, queue_size=10)
    rospy.Subscriber(
        "cmd_vel",
        Twist,
        lambda twist: body.command(twist.linear.x, twist.linear.y, twist.angular.z),
        queue_size=1,
        tcp_nodelay=True,
    )
    while not rospy.is_shutdown():
        frames.publish([transform(*frame) for frame in body.frames(*body.step(), odometry=options.odometry)])
        try:
            rospy.sleep(PERIOD)
        except rospy.ROSInterruptException:
            break


main()

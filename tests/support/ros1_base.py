"""A robot's base on ROS 1 without a body: it goes as ``/cmd_vel`` says, and tells its frames.

As a real base's driver it stands where no velocity came for half a second, and its odometry goes on whatever becomes of
who commands it. ``map`` to ``odom`` is told too, for want of a localiser. It prints ``moves`` and ``stands``, each with
``time.monotonic()`` and x, as that changes. Runs on the system's Python alone.
"""
# ruff: noqa: ANN204  # it runs without Midspan

import threading
import time

import rospy
from geometry_msgs.msg import TransformStamped, Twist
from tf2_msgs.msg import TFMessage

PERIOD = 0.05
WATCHDOG = 0.5


class Base:
    """It looks along x all the time, and moves any way."""

    def __init__(self):
        self.x = self.y = 0.0
        self.velocity, self.heard, self.moves = (0.0, 0.0), 0.0, False
        self.lock = threading.Lock()
        self.frames = rospy.Publisher("tf", TFMessage, queue_size=10)
        rospy.Subscriber("cmd_vel", Twist, self.hear, queue_size=1, tcp_nodelay=True)

    def hear(self, twist):
        with self.lock:
            self.velocity, self.heard = (twist.linear.x, twist.linear.y), time.monotonic()
            self.tell_moves()

    def tell_moves(self):
        moves = self.velocity != (0.0, 0.0)
        if moves != self.moves:
            self.moves = moves
            print("moves" if moves else "stands", time.monotonic(), round(self.x, 3), flush=True)

    def step(self):
        with self.lock:
            if time.monotonic() > self.heard + WATCHDOG:
                self.velocity = (0.0, 0.0)
            self.tell_moves()
            self.x, self.y = self.x + PERIOD * self.velocity[0], self.y + PERIOD * self.velocity[1]
            x, y = self.x, self.y
        self.frames.publish([frame("map", "odom", 0.0, 0.0), frame("odom", "base_link", x, y)])


def frame(parent, child, x, y):
    said = TransformStamped()
    said.header.frame_id, said.header.stamp, said.child_frame_id = parent, rospy.Time.now(), child
    said.transform.translation.x, said.transform.translation.y, said.transform.rotation.w = x, y, 1.0
    return said


def main():
    rospy.init_node("base")
    base = Base()
    while not rospy.is_shutdown():
        base.step()
        try:
            rospy.sleep(PERIOD)
        except rospy.ROSInterruptException:
            break


main()

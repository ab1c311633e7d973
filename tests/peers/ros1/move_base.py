"""A stand-in for ROS 1's move_base: a real actionlib server on rospy, which drives the base of `base.py`.

It copies the measured behavior of move_base (navigation 1.17, Noetic). A goal in an unknown frame, or in one with a
slash, stays ACTIVE forever. A new goal preempts the old one. ``/move_base_simple/goal`` becomes a goal on
``/move_base/goal``. The texts are move_base's. The stand-in starts its server once it has received the pose of
the base. actionlib's server itself provides the rest: the RECALLED state, repeated ids, cancel-all, long status lists,
unlatched results.

Goals with x of 900 and more are unreachable. The stand-in runs on the system's Python. It starts the base as a
process. With the argument ``there``, it uses a base that is already running and that keeps running when the stand-in
is killed or stopped. It prints ``ended`` and ``time.monotonic()`` whenever it ends a goal, except by preemption.
Usage: move_base.py SPEED PATIENCE [there [CYCLE]], CYCLE: seconds between two control cycles
"""
# ruff: noqa: ANN204  # it runs without Midspan

import math
import subprocess
import sys
import time
from pathlib import Path

import actionlib
import rospy
from geometry_msgs.msg import PoseStamped, Twist
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseFeedback, MoveBaseResult
from nav_msgs.srv import GetPlan, GetPlanResponse
from tf2_msgs.msg import TFMessage

PERIOD = float(sys.argv[4]) if len(sys.argv) > 4 else 0.1
NEAR, GAIN = 0.05, 5.0
"""Meters within which the goal is reached; gain of the approach, in m/s per remaining meter."""
UNREACHABLE = 900.0
FRAMES = ("map", "odom", "base_link")
ACCEPTED = "This goal has been accepted by the simple action server"
ANOTHER = "This goal was canceled because another goal was recieved by the simple action server"
NO_PLAN = "Failed to find a valid plan. Even after executing recovery behaviors."
QUATERNION = "Aborting on goal because it was sent with an invalid quaternion"


class MoveBase:
    """The node, which executes one goal at a time."""

    def __init__(self, speed, patience):
        self.speed, self.patience = speed, patience
        self.place = None
        self.current, self.cycles, self.canceled = None, 0, False
        self.velocity = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        self.target = rospy.Publisher("move_base/current_goal", PoseStamped, queue_size=10)
        self.goals = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=10)
        rospy.Subscriber("tf", TFMessage, self.on_transforms, queue_size=10, tcp_nodelay=True)
        rospy.Subscriber("move_base_simple/goal", PoseStamped, self.on_pose, queue_size=1)
        rospy.Service("move_base/make_plan", GetPlan, self.plan)
        self.server = actionlib.ActionServer(
            "move_base", MoveBaseAction, self.on_goal, self.on_cancel, auto_start=False
        )
        self.lock = self.server.lock  # the server calls us with its lock held, so a second lock could deadlock

    def on_transforms(self, message):
        for frame in message.transforms:
            if frame.child_frame_id == "base_link":
                self.place = frame.transform.translation

    def on_pose(self, pose):
        goal = MoveBaseActionGoal()
        goal.header.stamp = rospy.Time.now()
        goal.goal.target_pose = pose
        self.goals.publish(goal)

    def plan(self, request):
        if self.current is not None:
            raise rospy.ServiceException("")
        answer = GetPlanResponse()
        answer.plan.poses = [request.start, request.goal]  # as in move_base, the path's own header has no frame
        return answer

    def on_goal(self, handle):
        """Handle a goal, whose id and stamp actionlib has already checked."""
        with self.lock:
            before = self.current
            if before is not None:
                if handle.get_goal_id().stamp < before.get_goal_id().stamp:
                    handle.set_canceled(text=ANOTHER)
                    return
                before.set_canceled(MoveBaseResult(), ANOTHER)
            self.current, self.cycles, self.canceled = handle, 0, False
            handle.set_accepted(ACCEPTED)
            turn = handle.get_goal().target_pose.pose.orientation
            if abs(math.hypot(math.hypot(turn.x, turn.y), math.hypot(turn.z, turn.w)) - 1.0) > 0.1:
                self.end("set_aborted", QUATERNION)
                return
            self.target.publish(handle.get_goal().target_pose)

    def on_cancel(self, handle):
        """Mark the goal as canceled; the next control cycle ends it."""
        with self.lock:
            if handle == self.current:
                self.canceled = True

    def end(self, how, text):
        handle, self.current = self.current, None
        self.velocity.publish(Twist())
        print("ended", time.monotonic(), flush=True)
        getattr(handle, how)(MoveBaseResult(), text)

    def step(self):
        """Run one control cycle."""
        with self.lock:
            if self.current is None:
                return
            self.cycles += 1
            goal = self.current.get_goal().target_pose
            if self.canceled:
                self.end("set_canceled", "")
            elif goal.header.frame_id not in FRAMES:
                self.target.publish(goal)
            elif goal.pose.position.x >= UNREACHABLE:
                if self.cycles * PERIOD >= self.patience:
                    self.end("set_aborted", NO_PLAN)
            else:
                self.drive(goal.pose.position)

    def drive(self, place):
        dx, dy = place.x - self.place.x, place.y - self.place.y
        left = math.hypot(dx, dy)
        self.current.publish_feedback(MoveBaseFeedback(base_position=self.pose()))
        if left < NEAR:
            self.end("set_succeeded", "Goal reached.")
            return
        speed, moving = min(self.speed, GAIN * left), Twist()
        moving.linear.x, moving.linear.y = speed * dx / left, speed * dy / left
        self.velocity.publish(moving)

    def pose(self):
        pose = PoseStamped()
        pose.header.frame_id, pose.header.stamp = "map", rospy.Time.now()
        pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = self.place.x, self.place.y, 1.0
        return pose


def main():
    if "there" not in sys.argv[3:4]:
        subprocess.Popen([sys.executable, str(Path(__file__).with_name("base.py"))])
    rospy.init_node("move_base")
    planner = MoveBase(float(sys.argv[1]), float(sys.argv[2]))
    while planner.place is None and not rospy.is_shutdown():
        rospy.sleep(PERIOD)
    planner.server.start()
    print("ready", flush=True)
    while not rospy.is_shutdown():
        planner.step()
        try:
            rospy.sleep(PERIOD)
        except rospy.ROSInterruptException:
            break


main()

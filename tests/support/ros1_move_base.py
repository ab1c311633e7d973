"""A stand-in for ROS 1's move_base: a real actionlib server on rospy, whose robot is a point that the stand-in moves.

It behaves as a real move_base was measured to (navigation 1.17, Noetic): an unknown frame, or one with a slash, stays
ACTIVE for ever; a new goal preempts the old one; ``/move_base_simple/goal`` becomes a goal on ``/move_base/goal``; the
texts are move_base's. What actionlib's server does (RECALLED by stamps, repeated ids, cancel-all, a list of many
statuses, results that are not latched) is its own.

Goals with x of 900 and more are unreachable. Runs on the system's Python alone.
Usage: ros1_move_base.py SPEED PATIENCE
"""
# ruff: noqa: ANN204  # it runs without Midspan

import math
import sys

import actionlib
import rospy
from geometry_msgs.msg import PoseStamped, TransformStamped, Twist
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseFeedback, MoveBaseResult
from nav_msgs.srv import GetPlan, GetPlanResponse
from tf2_msgs.msg import TFMessage

PERIOD = 0.1
UNREACHABLE = 900.0
FRAMES = ("map", "odom", "base_link")
ACCEPTED = "This goal has been accepted by the simple action server"
ANOTHER = "This goal was canceled because another goal was recieved by the simple action server"
NO_PLAN = "Failed to find a valid plan. Even after executing recovery behaviors."
QUATERNION = "Aborting on goal because it was sent with an invalid quaternion"


class MoveBase:
    """One goal at a time."""

    def __init__(self, speed, patience):
        self.speed, self.patience = speed, patience
        self.x = self.y = 0.0
        self.current, self.since, self.cancelled = None, 0, False
        self.velocity = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        self.target = rospy.Publisher("move_base/current_goal", PoseStamped, queue_size=10)
        self.goals = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=10)
        self.frames = rospy.Publisher("tf", TFMessage, queue_size=10)
        rospy.Subscriber("move_base_simple/goal", PoseStamped, self.simple, queue_size=1)
        rospy.Service("move_base/make_plan", GetPlan, self.plan)
        self.server = actionlib.ActionServer("move_base", MoveBaseAction, self.take, self.cancel, auto_start=False)
        self.lock = self.server.lock  # it calls us under its own: a second one would be taken in both orders
        self.server.start()

    def simple(self, pose):
        goal = MoveBaseActionGoal()
        goal.header.stamp = rospy.Time.now()
        goal.goal.target_pose = pose
        self.goals.publish(goal)

    def plan(self, request):
        if self.current is not None:
            raise rospy.ServiceException("")
        answer = GetPlanResponse()
        answer.plan.poses = [request.start, request.goal]  # its header's frame stays empty
        return answer

    def take(self, handle):
        """A goal came; actionlib has looked at its id and stamp already."""
        with self.lock:
            before = self.current
            if before is not None:
                if handle.get_goal_id().stamp < before.get_goal_id().stamp:
                    handle.set_canceled(text=ANOTHER)
                    return
                before.set_canceled(MoveBaseResult(), ANOTHER)
            self.current, self.since, self.cancelled = handle, 0, False
            handle.set_accepted(ACCEPTED)
            turn = handle.get_goal().target_pose.pose.orientation
            if abs(math.hypot(math.hypot(turn.x, turn.y), math.hypot(turn.z, turn.w)) - 1.0) > 0.1:
                self.end("set_aborted", QUATERNION)
                return
            self.target.publish(handle.get_goal().target_pose)

    def cancel(self, handle):
        """It is given up at the next control cycle."""
        with self.lock:
            if handle == self.current:
                self.cancelled = True

    def end(self, how, text):
        handle, self.current = self.current, None
        getattr(handle, how)(MoveBaseResult(), text)
        self.velocity.publish(Twist())

    def step(self):
        """One control cycle."""
        with self.lock:
            self.tell_frame()
            if self.current is None:
                return
            self.since += 1
            goal = self.current.get_goal().target_pose
            if self.cancelled:
                self.end("set_canceled", "")
            elif goal.header.frame_id not in FRAMES:
                self.target.publish(goal)
            elif goal.pose.position.x >= UNREACHABLE:
                if self.since * PERIOD >= self.patience:
                    self.end("set_aborted", NO_PLAN)
            else:
                self.drive(goal.pose.position)

    def drive(self, place):
        dx, dy = place.x - self.x, place.y - self.y
        left = math.hypot(dx, dy)
        step = min(1.0, self.speed * PERIOD / left) if left else 1.0
        self.x, self.y = self.x + step * dx, self.y + step * dy
        self.current.publish_feedback(MoveBaseFeedback(base_position=self.pose()))
        if step == 1.0:
            self.end("set_succeeded", "Goal reached.")
            return
        moving = Twist()
        moving.linear.x = self.speed
        self.velocity.publish(moving)

    def pose(self):
        pose = PoseStamped()
        pose.header.frame_id, pose.header.stamp = "map", rospy.Time.now()
        pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = self.x, self.y, 1.0
        return pose

    def tell_frame(self):
        frame, pose = TransformStamped(), self.pose()
        frame.header, frame.child_frame_id = pose.header, "base_link"
        frame.transform.translation.x, frame.transform.translation.y = self.x, self.y
        frame.transform.rotation = pose.pose.orientation
        self.frames.publish([frame])


def main():
    rospy.init_node("move_base")
    planner = MoveBase(float(sys.argv[1]), float(sys.argv[2]))
    print("ready", flush=True)
    while not rospy.is_shutdown():
        planner.step()
        try:
            rospy.sleep(PERIOD)
        except rospy.ROSInterruptException:
            break


main()

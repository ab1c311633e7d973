"""A stand-in for ROS 1's amcl, for a robot whose odometry never drifts from the map.

Like amcl, it publishes ``/amcl_pose`` rarely: at the start, and after each ``/initialpose``. The current pose is in
/tf.
"""
# ruff: noqa: ANN202  # it runs without Midspan

import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from tf2_msgs.msg import TFMessage

PERIOD = 0.05
VARIANCES = {0: 0.04, 7: 0.09, 35: 0.01}
"""Variances of x, y and yaw, by their index in the covariance."""


def main():
    rospy.init_node("amcl")
    frames = rospy.Publisher("tf", TFMessage, queue_size=10)
    poses = rospy.Publisher("amcl_pose", PoseWithCovarianceStamped, queue_size=2, latch=True)

    def publish_pose(initial):
        pose = PoseWithCovarianceStamped()
        pose.header.frame_id, pose.header.stamp = "map", rospy.Time.now()
        pose.pose.pose = initial.pose.pose
        for place, variance in VARIANCES.items():
            pose.pose.covariance[place] = variance
        poses.publish(pose)

    rospy.Subscriber("initialpose", PoseWithCovarianceStamped, publish_pose, queue_size=2)
    first = PoseWithCovarianceStamped()
    first.pose.pose.orientation.w = 1.0
    publish_pose(first)
    while not rospy.is_shutdown():
        frame = TransformStamped()
        frame.header.frame_id, frame.header.stamp = "map", rospy.Time.now()
        frame.child_frame_id = "odom"
        frame.transform.rotation.w = 1.0
        frames.publish([frame])
        try:
            rospy.sleep(PERIOD)
        except rospy.ROSInterruptException:
            break


main()

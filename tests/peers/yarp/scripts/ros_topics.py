"""Publishes a ROS topic and waits for another one, through a Midspan daemon, which provides the types."""

import sys

import yarp

yarp.Network.init()
node = yarp.Node("/script")
twist = yarp.rosmsg.geometry_msgs.Twist()
twist.linear.x = 0.25
twist.angular.z = -1.5
publisher = yarp.Publisher("geometry_msgs/Twist")
subscriber = yarp.Subscriber("geometry_msgs/PoseStamped")
if not (publisher.topic("/velocity") and subscriber.topic("/goal")):
    sys.exit("the topics do not open")
pose = None
while pose is None:
    publisher.write(twist)
    yarp.delay(0.05)
    pose = subscriber.read(False)
print(pose.header.frame_id, pose.header.stamp.sec, pose.pose.position.x, pose.pose.orientation.w)
node.close()
yarp.Network.fini()

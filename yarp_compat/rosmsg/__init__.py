"""ROS messages for YARP scripts: classes made from ``.msg`` files when they are asked for, without any ROS library."""

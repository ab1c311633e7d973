"""The content of YARP ports for each ROS message, and its conversion from and to CDR."""

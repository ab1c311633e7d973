"""What YARP ports carry for each ROS message, and the ways from CDR to there and back."""

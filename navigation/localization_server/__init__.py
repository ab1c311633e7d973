"""LocalizationServer: where the robot is, for YARP and for all sides; with a localiser of its own."""

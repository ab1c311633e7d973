"""The YARP side, where each topic has ports."""

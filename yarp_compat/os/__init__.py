"""What YARP users know from `yarp::os`: Bottle, Port, Network, RFModule and their kin."""

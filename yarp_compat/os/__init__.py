"""The classes of `yarp::os`: Bottle, Port, Network, RFModule and others."""

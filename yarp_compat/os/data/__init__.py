"""The data that YARP users know: Bottle, Value, Property, Stamp, vectors of C++."""

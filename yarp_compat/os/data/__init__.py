"""YARP's data classes: Bottle, Value, Property, Stamp, and C++'s vectors."""

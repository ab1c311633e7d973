"""YARP in pure Python: ports, names and data that real YARP programs take for their own."""

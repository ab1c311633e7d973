"""YARP's device interfaces: data types, services, clients and servers; each in the file of its name."""

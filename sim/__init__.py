"""A mobile base in DART: floor plans, the R1's base, a laser, on the hub and on YARP."""

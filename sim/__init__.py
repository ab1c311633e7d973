"""A simulated mobile base in DART: floor plans, the R1's base, laser and depth camera, on the hub and on YARP."""

"""YARP: name servers, programs, scripts and devices."""

"""Control boards (the joints of a robot part) in the protocols of YARP 3 and 4: client, views and server."""

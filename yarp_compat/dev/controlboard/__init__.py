"""Control boards: the joints of a robot's part, by YARP's wire of 3.x and of 4.0; client, views, and server."""

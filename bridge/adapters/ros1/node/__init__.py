"""This node on the ROS 1 graph: its address, its slave API and its TCPROS server."""

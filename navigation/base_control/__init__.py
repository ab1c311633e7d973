"""BaseControl: drives a mobile base as its inputs command, within its limits, and publishes its odometry."""

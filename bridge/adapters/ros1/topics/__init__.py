"""ROS 1 topics: subscriptions and publications, as raw bytes."""

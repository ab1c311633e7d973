"""ROS 2 topics: subscriptions and publishers, as raw bytes."""

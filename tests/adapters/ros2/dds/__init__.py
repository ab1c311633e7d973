"""Tests of `bridge.adapters.ros2.dds`."""

"""Tests of `bridge.adapters.ros1.topics`."""

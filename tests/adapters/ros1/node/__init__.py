"""Tests of `bridge.adapters.ros1.node`."""

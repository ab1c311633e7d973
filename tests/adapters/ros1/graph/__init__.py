"""Tests of `bridge.adapters.ros1.graph`."""

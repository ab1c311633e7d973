"""Tests of `bridge.adapters.ros1.parameters`."""

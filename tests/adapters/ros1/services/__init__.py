"""Tests of `bridge.adapters.ros1.services`."""

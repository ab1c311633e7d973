"""Tests of `bridge.cli.ros1`."""

"""Tests of `bridge.cli.inspection`."""

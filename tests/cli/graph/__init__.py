"""Tests of `bridge.cli.graph`."""

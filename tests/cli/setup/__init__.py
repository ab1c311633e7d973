"""Tests of `bridge.cli.setup`."""

"""Tests of `bridge.cli.navigation`."""

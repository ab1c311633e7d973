"""Tests of `bridge.cli.maps`."""

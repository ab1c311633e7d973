"""Tests of `bridge.cli.frames`."""

"""Tests of `bridge.cli.bags`."""

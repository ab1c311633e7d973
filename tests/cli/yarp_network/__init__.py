"""Tests of `bridge.cli.yarp_network`."""

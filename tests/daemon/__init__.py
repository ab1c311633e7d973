"""Tests of bridge.daemon."""

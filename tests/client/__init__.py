"""Tests of `bridge.client`, and of the examples of the packages with a public API."""

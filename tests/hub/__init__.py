"""Tests of the hub, over real zenoh sessions."""

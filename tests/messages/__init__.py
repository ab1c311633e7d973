"""Tests of the message types and their conversion."""

"""Bags played onto the hub, each topic as its side would say it."""

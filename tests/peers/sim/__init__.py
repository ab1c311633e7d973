"""Simulated bases and floors."""

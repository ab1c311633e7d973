"""Bags: files of messages, played, looked at and converted."""

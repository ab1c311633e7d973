"""Bags: files of messages, in the formats that people use."""

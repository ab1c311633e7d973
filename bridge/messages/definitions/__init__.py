"""Definitions of message types: their model and text, their hashes, and where they are found."""

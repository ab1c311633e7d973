"""Midspan on arm64 under qemu (`scripts/arm64.py`), and the comparison of its results with those of this machine."""

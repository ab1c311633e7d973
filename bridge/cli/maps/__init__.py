"""The commands ``map`` and ``location``."""

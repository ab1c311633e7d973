"""The commands ``topic``, ``service`` and ``action``."""

"""The verbs ``map`` and ``location``."""

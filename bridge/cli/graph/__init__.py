"""The verbs ``topic``, ``service`` and ``action``."""

"""The verbs ``status``, ``top``, ``explain`` and ``doctor``."""

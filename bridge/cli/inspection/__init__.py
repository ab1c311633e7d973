"""The commands ``status``, ``top``, ``explain`` and ``doctor``."""

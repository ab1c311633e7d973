"""The commands ``bag`` and ``play``, for files of messages."""

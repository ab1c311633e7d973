"""The command ``tf``."""

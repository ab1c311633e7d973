"""The verb ``tf``."""

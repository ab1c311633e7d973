"""The console's fixture, for the figures that it serves."""

from tests.web.conftest import desk

__all__ = ["desk"]

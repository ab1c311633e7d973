"""The console's fixture, for the metrics that the console serves."""

from tests.web.conftest import desk

__all__ = ["desk"]

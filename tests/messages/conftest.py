"""One registry for all tests that do not change it."""

from __future__ import annotations

import pytest

from bridge.messages.registry import Registry
from tests.messages.samples import DATA


@pytest.fixture(scope="session")
def registry() -> Registry:
    """A registry of the installed types and the tests' folder of custom types."""
    return Registry(folders=[DATA])

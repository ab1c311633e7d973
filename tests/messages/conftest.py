"""One registry for the tests that change nothing in it."""

from __future__ import annotations

import pytest

from bridge.messages.registry import Registry
from tests.messages.samples import DATA


@pytest.fixture(scope="session")
def registry() -> Registry:
    """A registry of what is installed, with the tests' folder of custom types."""
    return Registry(folders=[DATA])

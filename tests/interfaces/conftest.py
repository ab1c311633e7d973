"""Packages that are built once for all tests of the builder."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.interfaces import build
from tests.interfaces.packages import PACKAGES


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("interfaces")


@pytest.fixture(scope="session")
def built(cache: Path) -> Path:
    return build(PACKAGES, cache)

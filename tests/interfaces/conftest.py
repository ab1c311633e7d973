"""Packages that are built once for all tests of the builder."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from bridge.interfaces import build, build_bundled
from bridge.interfaces.cache import members
from tests.interfaces.packages import PACKAGES


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache with the bundled package that a test package uses, as built by the set-up."""
    folder = tmp_path_factory.mktemp("interfaces")
    bundled = members(build_bundled())["tf2_msgs"]
    shutil.copytree(bundled, folder / "packages" / bundled.name, symlinks=True)
    return folder


@pytest.fixture(scope="session")
def built(cache: Path) -> Path:
    return build(PACKAGES, cache)

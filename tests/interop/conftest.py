"""Fixtures of the whole-daemon tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.interop.deployment import Deployment


@pytest.fixture
def deployment(tmp_path: Path) -> Iterator[Deployment]:
    """A deployment that the test starts itself."""
    with Deployment(tmp_path) as made:
        yield made


@pytest.fixture
def running(deployment: Deployment) -> Deployment:
    """A deployment with the default rules, both sides joined."""
    deployment.start()
    return deployment

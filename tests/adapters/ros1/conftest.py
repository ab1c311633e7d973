"""One roscore for the tests of a module that do not stop it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.ros1 import RosMaster


@pytest.fixture(scope="module")
def master() -> Iterator[RosMaster]:
    """A roscore that stays for the whole module; tests use topic and node names of their own."""
    with RosMaster() as master:
        yield master

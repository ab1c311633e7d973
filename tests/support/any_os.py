"""A pytest plugin, ``-p tests.support.any_os``, that hides what Windows lacks before tests are imported."""

from __future__ import annotations

import _pytest.tmpdir
import hypothesis  # the test tools need what is hidden from the tested code
import pytest

from tests.support.hidden import HIDE, LIBRARIES

exec(LIBRARIES + HIDE, {"__name__": __name__})
_pytest.tmpdir.get_user_id = lambda: None  # type: ignore[attr-defined]  # as on Windows


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """Run few examples: more would test only the code's logic, which the runs without this plugin do."""
    hypothesis.settings.load_profile("few")

"""A plugin of pytest, ``-p tests.support.any_os``: hides what Windows does not have before a test is imported."""

from __future__ import annotations

import _pytest.tmpdir
import hypothesis  # noqa: F401  what tests stand on is there before it is hidden from what they test

from tests.support.hidden import HIDE, LIBRARIES

exec(LIBRARIES + HIDE, {"__name__": __name__})
_pytest.tmpdir.get_user_id = lambda: None  # type: ignore[attr-defined]  # as it is on Windows

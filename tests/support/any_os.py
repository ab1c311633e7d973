"""A pytest plugin, ``-p tests.support.any_os``, that hides what Windows lacks before tests are imported."""

from __future__ import annotations

import _pytest.tmpdir
import hypothesis  # noqa: F401  the test tools need what is hidden from the tested code

from tests.support.hidden import HIDE, LIBRARIES

exec(LIBRARIES + HIDE, {"__name__": __name__})
_pytest.tmpdir.get_user_id = lambda: None  # type: ignore[attr-defined]  # as on Windows

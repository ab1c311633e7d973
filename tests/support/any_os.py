"""A pytest plugin, ``-p tests.support.any_os``: hides what Windows lacks before tests are imported."""

from __future__ import annotations

import os
import types

import _pytest.tmpdir
import hypothesis  # noqa: F401  the test tools need what is hidden from the tested code
import psutil

from tests.support.hidden import HIDE

_whole = types.ModuleType("os")
vars(_whole).update(vars(os))
for _module in (psutil, psutil._common, psutil._pslinux, psutil._psposix):
    _module.os = _whole  # type: ignore[attr-defined]
exec(HIDE, {"__name__": __name__})
_pytest.tmpdir.get_user_id = lambda: None  # type: ignore[attr-defined]  # as on Windows

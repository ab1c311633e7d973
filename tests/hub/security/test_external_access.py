"""The state of the router for other machines while it cannot be opened."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.config.model import Config
from bridge.hub.errors import HubError
from bridge.hub.security import external_access
from bridge.hub.security.external_access import ExternalAccess


def config(**section: Any) -> Config:
    return Config.model_validate({"hub": {"open": section}})


def test_a_removed_section_ends_the_report_of_its_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise HubError("the address is in use")

    monkeypatch.setattr(external_access, "ExternalRouter", fail)
    access = ExternalAccess(None)
    access.open(config(listen=["tcp/192.0.2.1:7449"], insecure=True))
    assert access.text() == "; closed to other machines: the address is in use"
    access.reopen(config())
    assert (access.trouble, access.text()) == ("", "")
    access.check(config())
    assert access.router is None

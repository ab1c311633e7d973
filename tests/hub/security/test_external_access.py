"""The state of the router for other machines while it cannot be opened."""

from __future__ import annotations

import time
from typing import Any, cast

import pytest
import zenoh

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


class ClosingRouter:
    """A router that is closed while its status is read."""

    def __init__(self, access: ExternalAccess, *, ended: bool) -> None:
        self._access, self._ended = access, ended

    @property
    def zid(self) -> str:
        self._access.router = None
        return "1"

    def machines(self) -> list[object]:
        if self._ended:
            raise zenoh.ZError("the session is closed")
        return []

    def endpoints(self) -> list[object]:
        return []

    def refused(self) -> int:
        return 0


@pytest.mark.parametrize("ended", [False, True])
def test_status_is_available_while_the_router_is_replaced(*, ended: bool) -> None:
    """The main thread replaces the router, for example for new certificates, while another thread reads the status."""
    access = ExternalAccess(None)
    access.router = cast("Any", ClosingRouter(access, ended=ended))
    status = access.status(config(listen=["tcp/192.0.2.1:7449"], insecure=True))
    states = [endpoint.state for endpoint in status.endpoints]
    assert (status.door, states) == (("", ["closed"]) if ended else ("1", []))


def test_endpoints_of_a_router_that_is_being_replaced_are_closed_since_then() -> None:
    access = ExternalAccess(None)
    before = time.time()
    access.close()
    (endpoint,) = access.status(config(listen=["tcp/192.0.2.1:7449"], insecure=True)).endpoints
    assert endpoint.since is not None
    assert endpoint.since >= before - 0.1


def test_a_set_clock_does_not_change_the_age_of_a_state(monkeypatch: pytest.MonkeyPatch) -> None:
    access = ExternalAccess(None)
    access.close()
    day, now = 86400.0, time.time
    monkeypatch.setattr(time, "time", lambda: now() + day)
    (endpoint,) = access.status(config(listen=["tcp/192.0.2.1:7449"], insecure=True)).endpoints
    assert endpoint.since is not None
    assert time.time() - endpoint.since < day / 2

"""A link that lacks its neighbor's token is closed, and zenoh connects it again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import zenoh

from bridge.hub.security import link_restart
from bridge.hub.security.link_restart import LinkRestarts
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, router_tree
from tests.support.ports import free_port
from tests.support.wait import until


@contextmanager
def routers() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Open two routers; the first connects to the second."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    connecting = router_tree([], max_payload=MAX_PAYLOAD)
    connecting["connect"]["endpoints"] = [endpoint]
    with (
        zenoh.open(make_config(router_tree([endpoint], max_payload=MAX_PAYLOAD), None)) as listener,
        zenoh.open(make_config(connecting, None)) as connector,
    ):
        until(lambda: listener.info.links() and connector.info.links(), "the routers are linked")
        yield connector, listener


def addresses(session: zenoh.Session) -> set[tuple[str, str]]:
    return {(str(link.src), str(link.dst)) for link in session.info.links()}


@pytest.mark.parametrize("connects", [True, False])
def test_a_link_whose_token_has_disappeared_is_restarted(monkeypatch: pytest.MonkeyPatch, *, connects: bool) -> None:
    monkeypatch.setattr(link_restart, "_SECONDS", 0.0)
    with routers() as pair:
        here, other = pair if connects else pair[::-1]
        restarts, before = LinkRestarts(here), addresses(here)
        token = other.liveliness().declare_token(f"{link_restart._KEY}/{other.zid()}")
        until(lambda: list(here.liveliness().get(f"{link_restart._KEY}/{other.zid()}")), "the token arrives")
        restarts.check()
        assert addresses(here) == before
        token.undeclare()
        until(lambda: restarts.check() or not before & addresses(here), "the link is closed")
        until(lambda: addresses(here) or restarts.check(), "the link is restored")
        restarts.close()


def test_a_neighbor_that_never_had_a_token_keeps_its_link(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_restart, "_SECONDS", 0.0)
    with routers() as (here, _other):
        restarts, before = LinkRestarts(here), addresses(here)
        restarts.check()
        restarts.check()
        assert addresses(here) == before
        restarts.close()

"""A link that lacks its neighbor's token is closed, and zenoh connects it again."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
import zenoh

from bridge.hub.security import link_restart
from bridge.hub.security.link_restart import LinkRestarts
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, router_tree
from tests.support.ports import free_port
from tests.support.wait import until
from tests.support.zenoh_router import open_router


@contextmanager
def routers() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Open two routers; the first connects to the second."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    connecting = router_tree([], max_payload=MAX_PAYLOAD)
    connecting["connect"]["endpoints"] = [endpoint]
    with (
        open_router(make_config(router_tree([endpoint], max_payload=MAX_PAYLOAD), None)) as listener,
        open_router(make_config(connecting, None)) as connector,
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


def test_a_neighbor_that_receives_this_token_but_whose_own_does_not_arrive_is_restarted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(link_restart, "_SECONDS", 0.0)
    with routers() as (here, other):
        restarts, before = LinkRestarts(here), addresses(here)
        until(lambda: list(other.liveliness().get(f"{link_restart._KEY}/{here.zid()}")), "the token arrives")
        other.put(f"{link_restart._KEY}/{here.zid()}/{other.zid()}", b"")
        until(lambda: restarts.check() or not before & addresses(here), "the link is closed")
        restarts.close()


def test_a_router_that_takes_the_place_of_another_receives_the_state(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_restart, "_SECONDS", 0.5)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    tree = router_tree([], max_payload=MAX_PAYLOAD)
    tree["connect"]["endpoints"] = [endpoint]
    with open_router(make_config(router_tree([endpoint], max_payload=MAX_PAYLOAD), None)) as here:
        restarts, key = LinkRestarts(here), f"{link_restart._KEY}/{here.zid()}"

        def arrived(session: zenoh.Session, other: LinkRestarts | None = None) -> bool:
            for each in filter(None, (restarts, other)):
                each.check()
            return bool(list(session.liveliness().get(key)))

        for _ in range(3):  # on a busy machine, not each attempt takes less than 0.1 s
            time.sleep(0.3)  # zenoh computes its trees without the last router
            leaving = [open_router(make_config(tree, None)) for _ in range(2)]
            for session in leaving:
                until(lambda session=session: arrived(session), "the token arrives")
            time.sleep(0.3)  # zenoh computes its trees with both
            leaving[0].close()  # zenoh computes them at once, and not again within 0.1 s
            time.sleep(0.03)
            leaving[1].close()
            with open_router(make_config(tree, None)) as new:
                other = LinkRestarts(new)
                until(lambda new=new, other=other: arrived(new, other), "the token arrives")
                other.close()
        restarts.close()


def test_the_pauses_between_restarts_double_while_the_token_stays_away(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    restarted: list[float] = []
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(link_restart, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(link_restart, "close_connection", lambda *_: restarted.append(clock.now) or True)
    with routers() as (here, other):
        restarts = LinkRestarts(here)

        def lose_token() -> None:
            token = other.liveliness().declare_token(f"{link_restart._KEY}/{other.zid()}")
            key = f"{link_restart._KEY}/{other.zid()}"
            until(lambda: not restarts._lost and list(here.liveliness().get(key)), "the token arrives")
            token.undeclare()
            until(lambda: restarts._lost, "the token is lost")

        def pauses(seconds: int) -> list[float]:
            restarted.clear()
            start = clock.now
            for _ in range(seconds):
                clock.now += 1.0
                restarts.check()
            return [second - first for first, second in zip([start, *restarted], restarted, strict=False)]

        def logged() -> list[str]:
            return [record.getMessage() for record in caplog.records if record.name == link_restart.__name__]

        lose_token()
        restarts.check()
        assert pauses(260) == [2, 4, 7, 13, 25, 49, 61, 61]
        assert len(logged()) == 1
        assert pauses(600)[1:] == [61] * 9
        again = [message.partition(";")[2] for message in logged()]
        assert again == ["", " it did so 15 times: restart Midspan there"]
        lose_token()
        restarts.check()
        assert pauses(10) == [2, 4]
        restarts.close()


def test_time_in_which_this_process_was_stopped_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """The token may have arrived meanwhile, and is read only after the check."""
    restarted: list[float] = []
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(link_restart, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(link_restart, "close_connection", lambda *_: restarted.append(clock.now) or True)
    with routers() as (here, other):
        restarts, key = LinkRestarts(here), f"{link_restart._KEY}/{other.zid()}"
        token = other.liveliness().declare_token(key)
        until(lambda: list(here.liveliness().get(key)), "the token arrives")
        token.undeclare()
        until(lambda: restarts._lost, "the token is lost")
        restarts.check()
        for seconds in (60.0, 1.0, 1.0, 1.0):
            clock.now += seconds
            restarts.check()
        assert restarted == [63.0]
        restarts.close()

"""The feed of the current map while the map changes."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.web.feeds import maps
from bridge.web.feeds.map_pictures import Pictures
from bridge.web.feeds.maps import MapFeed, StoreFeed, StoreFollower, StoreView
from yarp_compat.dev.mapgrid import MapGrid2D

Jobs = list[Callable[[], None]]


class Page:
    """Collects the values of the feed."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def changed(self, _name: str, _n: int, text: str) -> None:
        self.texts.append(text)


def run(jobs: Jobs) -> None:
    while jobs:
        jobs.pop(0)()


def view(name: str) -> StoreView:
    return StoreView({}, {}, MapGrid2D() if name else None, name)


@pytest.fixture
def drawing(monkeypatch: pytest.MonkeyPatch) -> Jobs:
    """The jobs of the drawing thread."""
    jobs: Jobs = []
    monkeypatch.setattr(maps, "SerialExecutor", lambda _: SimpleNamespace(submit=jobs.append))
    return jobs


@pytest.fixture
def posted() -> Jobs:
    """The calls that the drawing thread passes to the module's."""
    return []


@pytest.fixture
def take(drawing: Jobs, posted: Jobs, page: Page) -> Callable[[StoreView], None]:
    """Pass the store's content to the watched feed."""
    taken: list[Callable[[StoreView], None]] = []
    host: Any = SimpleNamespace(loop=SimpleNamespace(post=posted.append))
    store: Any = SimpleNamespace(begin=lambda _feed, on_view: taken.append(on_view))
    MapFeed(host, Config(), store, Pictures()).watch(page)
    return taken[0]


@pytest.fixture
def page() -> Page:
    return Page()


@pytest.mark.parametrize("drawn", [True, False])
def test_map_that_is_no_longer_current_is_not_shown(
    take: Callable[[StoreView], None], drawing: Jobs, posted: Jobs, page: Page, drawn: bool
) -> None:
    take(view("hall"))
    if drawn:
        run(drawing)
    take(view(""))
    run(drawing)
    run(posted)
    assert "no current map" in page.texts[-1]
    take(view("hall"))
    run(drawing)
    run(posted)
    assert '"name":"hall"' in page.texts[-1]


def test_only_the_newest_of_the_waiting_maps_is_drawn(
    take: Callable[[StoreView], None], drawing: Jobs, posted: Jobs, page: Page
) -> None:
    for name in ("hall", "yard", "roof"):
        take(view(name))
    run(drawing)
    run(posted)
    assert len(page.texts) == 1
    assert '"name":"roof"' in page.texts[0]


def test_content_is_shown_again_after_an_unexpected_error(posted: Jobs, monkeypatch: pytest.MonkeyPatch) -> None:
    """The store's content is the same as before the error, so only the error is new."""
    replies: list[Any] = [[], TypeError("odd"), []]

    def digest() -> Any:
        reply = replies.pop(0)
        if isinstance(reply, Exception):
            raise reply
        return reply

    host: Any = SimpleNamespace(loop=SimpleNamespace(post=posted.append, every=lambda *_: None))
    follower, page = StoreFollower(host, Config()), Page()
    client: Any = SimpleNamespace(present=True, digest=digest, current_map=str, names=lambda _: [], all=lambda _: {})
    monkeypatch.setattr(follower, "_client", client)
    monkeypatch.setattr(follower, "_executor", SimpleNamespace(submit=lambda job: job()))
    StoreFeed("places", follower, lambda view: view.places).watch(page)
    run(posted)
    follower.refresh()
    run(posted)
    assert "TypeError: odd" in page.texts[-1]
    follower.refresh()
    run(posted)
    assert "locations" in page.texts[-1]

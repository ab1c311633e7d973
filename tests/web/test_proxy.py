"""The page, socket and map of a console that is used through a reverse proxy."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus

from bridge.hub.security.certificates import Authority
from bridge.stores.kinds import MAP
from bridge.stores.store import Store
from tests.peers.browser.proxy import WEB, Proxy
from tests.web.conftest import Desk
from tests.web.test_paint import house

ANNA = {"Authorization": f"Basic {base64.b64encode(b'anna:secret').decode()}"}


@pytest.fixture
def proxy(tmp_path: Path, desk: Desk) -> Iterator[Proxy]:
    desk.open_with(web=WEB)
    authority = Authority(tmp_path / "keys")
    authority.make()
    proxy = Proxy(tmp_path, tmp_path / "keys", desk.port)
    yield proxy
    proxy.close()


def test_page_socket_and_map_work_at_a_path_of_the_proxy(proxy: Proxy, store: Store) -> None:
    assert proxy.get("/robot1/")[0] == 401, "the proxy requires a login"
    status, headers, _ = proxy.get("/robot1", **ANNA)
    assert (status, headers["location"]) == (301, f"https://robots.example:{proxy.port}/robot1/")
    for path, part in (("", b"<title>"), ("app.js", b"Socket"), ("healthz", b"")):
        status, _, body = proxy.get(f"/robot1/{path}", **ANNA)
        assert (status, part in body) == (200, True), path
    store.put(MAP, "house", house())
    store.use_map("house")
    with proxy.page(**ANNA) as page:
        page.watch("map")
        ((tile,),) = page.value("map")["image"]["tiles"]
        assert tile.startswith("/robot1/map/")
        status, headers, body = proxy.get(tile, **ANNA)
        assert (status, headers["content-type"], body[1:4]) == (200, "image/png", b"PNG")


def test_pages_of_other_origins_are_refused_behind_the_proxy(proxy: Proxy) -> None:
    host = "robots.example"
    others = (f"http://{host}:{proxy.port}", f"https://{host}", f"https://{host}:{proxy.port + 1}")
    for origin in ("https://evil.example", "null", *others):
        with pytest.raises(InvalidStatus, match="403"):
            proxy.page(origin, **ANNA)
    status, _, body = proxy.get("/robot1/", Host="evil.example", **ANNA)
    assert (status, b"web.names" in body) == (403, True)

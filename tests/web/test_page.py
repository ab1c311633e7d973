"""A page that does not read its socket."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any, cast

import pytest
from starlette.websockets import WebSocketState

from bridge.web import outbox, page
from bridge.web.serving.access import EVERYBODY
from bridge.web.verbs.verbs import VerbError


class StuckSocket:
    """Sends many requests, and never finishes reading the first reply."""

    application_state = WebSocketState.CONNECTED
    client = None

    def __init__(self) -> None:
        self.asked = 0
        self.closed: int | None = None

    async def receive(self) -> dict[str, Any]:
        self.asked += 1
        await asyncio.sleep(0)  # the previous calls get their replies
        return {"type": "websocket.receive", "text": json.dumps({"op": "call", "id": self.asked, "verb": "fly"})}

    async def send_text(self, _text: str) -> None:
        await asyncio.Event().wait()

    async def close(self, code: int) -> None:
        self.closed = code


class NoVerbs:
    def is_command(self, _verb: str) -> bool:
        return True

    def is_stop(self, _verb: str) -> bool:
        return False

    def begin(self, verb: str, _args: Any, _who: str) -> Any:
        raise VerbError(f"unknown verb {verb}")


class NoHold:
    def release(self, _page: Any) -> None:
        return


def test_a_page_that_reads_no_replies_is_closed() -> None:
    socket = StuckSocket()

    def post(action: Callable[[], Any]) -> None:
        action()

    async def serve() -> None:
        nobody: Any = None
        page_ = page.Page(
            cast("Any", socket), EVERYBODY, {}, nobody, cast("Any", NoVerbs()), cast("Any", NoHold()), post
        )
        await asyncio.wait_for(page_.serve(), 30)

    asyncio.run(serve())
    assert socket.closed == 1008
    assert outbox.MOST_REPLIES <= socket.asked <= 2 * outbox.MOST_REPLIES


class RecordingHold:
    """A hold that records the page's actions."""

    def __init__(self) -> None:
        self.said: list[Any] = []

    def hold(self, _page: Any, x: float, _y: float, _turn: float, _arrived: float) -> None:
        self.said.append(x)

    def release(self, _page: Any) -> None:
        self.said.append("release")


class Script(StuckSocket):
    """A socket from which some messages arrive before it ends."""

    def __init__(self, *messages: dict[str, Any]) -> None:
        super().__init__()
        self._messages = [{"type": "websocket.receive", "text": json.dumps(message)} for message in messages]

    async def receive(self) -> dict[str, Any]:
        return self._messages.pop(0) if self._messages else {"type": "websocket.disconnect"}


def test_only_the_newest_hold_or_release_is_executed() -> None:
    holds = [{"op": "hold", "x": number, "y": 0, "turn": 0} for number in range(5)]
    watches = [{"op": "watch", "feed": f"f{number}"} for number in range(10)]
    script = Script(*watches * 30, *holds, {"op": "release"}, *watches)
    hold, waiting = RecordingHold(), []

    async def serve() -> None:
        nobody: Any = None
        verbs, held = cast("Any", NoVerbs()), cast("Any", hold)
        page_ = page.Page(cast("Any", script), EVERYBODY, {}, nobody, verbs, held, waiting.append)
        await asyncio.wait_for(page_.serve(), 30)
        for action in waiting[10:-1]:  # after the ten feeds, before the page is closed
            action()

    asyncio.run(serve())
    assert hold.said == ["release"]


class OneFeed:
    """A feed, and the feeds of which it is the only one."""

    def __init__(self) -> None:
        self.page: Any = None

    def find(self, _name: str) -> OneFeed:
        return self

    def watch(self, page: Any) -> None:
        self.page = page

    def unwatch(self, page: Any) -> None:
        assert page is self.page
        self.page = None


class ReadSocket(StuckSocket):
    """A socket whose page reads everything."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    async def send_text(self, text: str) -> None:
        self.texts.append(text)


def test_feed_that_is_watched_again_is_sent_after_an_undrawn_value() -> None:
    """A value may be sent while the page stops watching; the page ignores it, so it never reports it as drawn."""
    feed, socket, waiting = OneFeed(), ReadSocket(), list[Callable[[], Any]]()

    async def serve() -> list[str]:
        verbs, hold = cast("Any", NoVerbs()), cast("Any", NoHold())
        page_ = page.Page(cast("Any", socket), EVERYBODY, {}, cast("Any", feed), verbs, hold, waiting.append)
        sender = asyncio.create_task(page_._outbox.send_to(cast("Any", socket)))

        async def settle() -> None:
            for _ in range(20):
                await asyncio.sleep(0)

        async def run_posted() -> None:
            while waiting:
                waiting.pop(0)()
            await settle()

        page_._handle({"op": "watch", "feed": "robot"})
        await run_posted()
        page_._handle({"op": "unwatch", "feed": "robot"})
        feed.page.changed("robot", 1, "ignored")  # the module's thread has not handled the request yet
        await settle()
        await run_posted()
        page_._handle({"op": "watch", "feed": "robot"})
        await run_posted()
        feed.page.changed("robot", 2, "newest")
        await settle()
        sender.cancel()
        return socket.texts[1:]  # without the greeting

    assert asyncio.run(serve()) == ["ignored", "newest"]


def test_half_of_a_surrogate_pair_is_refused() -> None:
    """JSON permits it, but no page that watches the feed could receive it: a patrol's places are sent to all pages."""
    with pytest.raises(page.BadMessageError, match="surrogates not allowed"):
        page._parse({"text": '{"op": "call", "id": 1, "verb": "patrol", "args": {"places": ["\\ud800", "b"]}}'})
    assert page._parse({"text": '{"feed": "\\ud83d\\ude00 \\\\ud800"}'}) == {"feed": "\N{GRINNING FACE} \\ud800"}

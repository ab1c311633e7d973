"""A page whose socket does not take what is sent."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any, cast

from starlette.websockets import WebSocketState

from bridge.web import page
from bridge.web.access import EVERYBODY
from bridge.web.verbs import VerbError


class StuckSocket:
    """Asks and asks, and takes one answer."""

    application_state = WebSocketState.CONNECTED
    client = None

    def __init__(self) -> None:
        self.asked = 0
        self.closed: int | None = None

    async def receive(self) -> dict[str, Any]:
        self.asked += 1
        await asyncio.sleep(0)  # the calls before this one are answered
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
        raise VerbError(f"there is no verb {verb}")


class NoHold:
    def release(self, _page: Any) -> None:
        return


def test_a_page_that_reads_no_answers_is_closed() -> None:
    socket = StuckSocket()

    def post(action: Callable[[], Any]) -> None:
        action()

    async def serve() -> None:
        nobody: Any = None
        made = page.Page(
            cast("Any", socket), EVERYBODY, {}, nobody, cast("Any", NoVerbs()), cast("Any", NoHold()), post
        )
        await asyncio.wait_for(made.serve(), 30)

    asyncio.run(serve())
    assert socket.closed == 1008
    assert page.MOST_REPLIES <= socket.asked <= 2 * page.MOST_REPLIES

"""The queues of one page: messages for the page, and its actions for the module's thread."""

from __future__ import annotations

import asyncio
import json
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from starlette.websockets import WebSocket

MOST_REPLIES = 500
MOST_ACTIONS = 200

Post = Callable[[Callable[[], Any]], None]
"""Runs an action on the module's thread."""


class PageOutbox:
    """Messages for one page: all replies in order, but only the newest value of each feed and the newest velocity.

    The outbox watches feeds and drives on behalf of the page; the module's thread calls `changed`, `held` and `refuse`.
    ``_lock`` guards the values that these methods write; the rest is used only on the server's event loop.

    Attributes:
        who: the page's user, for the log.
        full: whether a reply was dropped because the page does not read its replies.
    """

    def __init__(self, who: str) -> None:
        self.who = who
        self.full = False
        self._loop = asyncio.get_running_loop()
        self._wake = asyncio.Event()
        self._replies: deque[str] = deque()
        self._drawing: dict[str, int] = {}  # feeds whose value the page has not yet drawn
        self._lock = threading.Lock()
        self._unsent: dict[str, tuple[int, str]] = {}  # newest values that are not sent yet
        self._held = ""  # the newest commanded velocity, if it is not sent yet

    # -- called on the module's thread ---------------------------------------------------------------------------------

    def changed(self, name: str, n: int, text: str) -> None:
        """Cache a feed's newest value until the page is ready for it."""
        with self._lock:
            self._unsent[name] = (n, text)
        self.call_soon(self._wake.set)

    def held(self, x: float, y: float, turn: float) -> None:
        """Send the page the velocity that is commanded for it."""
        with self._lock:
            self._held = json.dumps({"op": "held", "x": x, "y": y, "turn": turn})
        self.call_soon(self._wake.set)

    def refuse(self, why: str) -> None:
        """Send the page the reason for a refusal."""
        self.call_soon(lambda: self.queue({"op": "error", "error": why}))

    def discard(self, name: str) -> None:
        """Drop the value of a feed that the page no longer watches."""
        with self._lock:
            self._unsent.pop(name, None)

    def call_soon(self, action: Callable[[], Any]) -> None:
        """Run an action on the server's event loop, if it still runs."""
        try:
            self._loop.call_soon_threadsafe(action)
        except RuntimeError:  # the server has ended
            return

    # -- on the server's event loop ------------------------------------------------------------------------------------

    def queue(self, message: dict[str, Any]) -> None:
        """Queue a message; if too many are queued, because the page does not read them, drop it and set ``full``."""
        if len(self._replies) >= MOST_REPLIES:
            self.full = True
            return
        self._replies.append(json.dumps(message, ensure_ascii=False))
        self._wake.set()

    def drawn(self, name: str, n: int) -> None:
        """Record that the page has drawn a feed's value ``n``, so that the next value may be sent."""
        if self._drawing.get(name) == n:
            del self._drawing[name]
            self._wake.set()

    def unwatched(self, name: str) -> None:
        """No longer wait for the page to draw a feed's value, because it no longer watches the feed."""
        self._drawing.pop(name, None)

    async def send_to(self, socket: WebSocket) -> None:
        """Send the messages as they become due, until the task is canceled."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._replies:
                await socket.send_text(self._replies.popleft())
            for text in self._due():
                await socket.send_text(text)

    def _due(self) -> list[str]:
        """Return the commanded velocity, and the newest values of the feeds whose previous value the page has drawn."""
        with self._lock:
            due = [name for name in self._unsent if name not in self._drawing]
            values = [(name, *self._unsent.pop(name)) for name in due]
            held, self._held = self._held, ""
        self._drawing.update((name, n) for name, n, _ in values)
        return [*filter(None, [held]), *(text for _, _, text in values)]


class PostedActions:
    """A page's actions that wait for the module's thread. ``_lock`` guards the count and the newest action."""

    def __init__(self, post: Post) -> None:
        self._post = post
        self._lock = threading.Lock()
        self._count = 0
        self._newest: Callable[[], None] | None = None

    def run(self, action: Callable[[], Any]) -> bool:
        """Run an action on the module's thread; return False if too many wait already."""
        with self._lock:
            if self._count >= MOST_ACTIONS:
                return False
            self._count += 1

        def run() -> None:
            with self._lock:
                self._count -= 1
            action()

        self._post(run)
        return True

    def run_latest(self, action: Callable[[], None]) -> None:
        """Run an action, which replaces a waiting one; for hold and release, and never refused."""
        with self._lock:
            waits, self._newest = self._newest is not None, action
        if not waits:
            self._post(self._run_newest)

    def _run_newest(self) -> None:
        with self._lock:
            action, self._newest = self._newest, None
        if action is not None:
            action()

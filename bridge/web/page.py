"""One page's conversation over its WebSocket; see docs/operate/console_protocol.md. On the server's event loop."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from bridge.web.feeds.feed import Feed, Feeds
from bridge.web.serving.access import Grant
from bridge.web.serving.login import who
from bridge.web.verbs.hold import HandDriving
from bridge.web.verbs.verbs import VerbError, Verbs, number_between

_log = logging.getLogger("midspan.web")

MOST_FEEDS = 64
MOST_CALLS, MOST_STOPS = 16, 64
"""Pending calls of a page; stops have a separate limit."""
MOST_ERRORS = 20
MOST_WAITING = 200
MOST_REPLIES = 500
_POLICY = 1008
_check_speed = number_between(-1e9, 1e9)
_WATCHES = "this page has the role 'watch'"

Post = Callable[[Callable[[], Any]], None]
"""Runs an action on the module's thread."""


class BadMessageError(ValueError):
    """A page's message is invalid; the text is the reason."""


class Page:
    """Serves one socket until it ends."""

    def __init__(
        self,
        socket: WebSocket,
        grant: Grant,
        hello: dict[str, Any],
        feeds: Feeds,
        verbs: Verbs,
        hold: HandDriving,
        post: Post,
    ) -> None:
        self._socket, self._grant, self._feeds, self._verbs, self._hold, self._post = (
            socket, grant, feeds, verbs, hold, post,
        )  # fmt: skip
        self._hello = {**hello, "role": grant.role, "who": grant.name}
        self._loop = asyncio.get_running_loop()
        self._wake = asyncio.Event()
        self._lock = threading.Lock()
        self._news: dict[str, tuple[int, str]] = {}  # newest values that are not sent yet
        self._replies: deque[str] = deque()
        self._held = ""  # the newest commanded velocity, if it is not sent yet
        self._drawing: dict[str, int] = {}  # feeds whose value the page has not yet drawn
        self._watched: set[str] = set()  # as the page has asked, on the server's event loop
        self._open: dict[str, Feed] = {}  # as it is, on the module's thread
        self._calls: set[asyncio.Task[None]] = set()
        self._stops: set[asyncio.Task[None]] = set()  # those of them that stop robots
        self._errors = 0
        self._deaf = False
        self._newest_action: Callable[[], None] | None = None  # the newest hold or release that has not run yet
        self._posted = 0
        self.who = who(grant, f"{socket.client.host}:{socket.client.port}" if socket.client else "a page")

    async def serve(self) -> None:
        """Serve the page until the socket ends; its hold and its feeds end with it."""
        self._queue(self._hello)
        sender = asyncio.create_task(self._send())
        try:
            await self._receive()
        except (WebSocketDisconnect, RuntimeError):  # starlette raises them after the other end closed
            pass
        finally:
            self._post(self._unwatch_all)
            sender.cancel()
            for call in self._calls - self._stops:  # calls that have started continue, and stops are never canceled
                call.cancel()

    def _unwatch_all(self) -> None:
        self._hold.release(self)
        while self._open:
            self._open.popitem()[1].unwatch(self)

    # -- called on the module's thread ---------------------------------------------------------------------------------

    def changed(self, name: str, n: int, text: str) -> None:
        """Cache a feed's newest value until the page is ready for it."""
        with self._lock:
            self._news[name] = (n, text)
        self._call_soon(self._wake.set)

    def held(self, x: float, y: float, turn: float) -> None:
        """Send the page the velocity that is commanded for it."""
        with self._lock:
            self._held = json.dumps({"op": "held", "x": x, "y": y, "turn": turn})
        self._call_soon(self._wake.set)

    def refuse(self, why: str) -> None:
        """Send the page the reason for a refusal."""
        self._call_soon(lambda: self._queue({"op": "error", "error": why}))

    def _call_soon(self, action: Callable[[], Any]) -> None:
        try:
            self._loop.call_soon_threadsafe(action)
        except RuntimeError:  # the server has ended
            return

    # -- on the server's event loop ------------------------------------------------------------------------------------

    async def _send(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._replies:
                await self._socket.send_text(self._replies.popleft())
            for text in self._due():
                await self._socket.send_text(text)

    def _due(self) -> list[str]:
        """Return the commanded velocity, and the newest values of the feeds whose last one the page has drawn."""
        with self._lock:
            due = [name for name in self._news if name not in self._drawing]
            values = [(name, *self._news.pop(name)) for name in due]
            held, self._held = self._held, ""
        self._drawing.update((name, n) for name, n, _ in values)
        return [*filter(None, [held]), *(text for _, _, text in values)]

    def _queue(self, message: dict[str, Any]) -> None:
        if len(self._replies) >= MOST_REPLIES:  # the page sends requests but does not read replies
            self._deaf = True
            return
        self._replies.append(json.dumps(message, ensure_ascii=False))
        self._wake.set()

    async def _receive(self) -> None:
        while self._socket.application_state is WebSocketState.CONNECTED:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            try:
                self._handle(_parsed(message))
            except BadMessageError as err:
                self._errors += 1
                self._queue({"op": "error", "error": str(err)})
            if self._errors > MOST_ERRORS or self._deaf:
                reason = f"it has not read {MOST_REPLIES} replies" if self._deaf else f"{MOST_ERRORS} invalid messages"
                _log.warning("%s: closing its socket: %s", self.who, reason)
                await self._socket.close(_POLICY)
                return

    def _handle(self, message: dict[str, Any]) -> None:
        match message:
            case {"op": "watch", "feed": str(name), **rest} if not rest:
                self._watch(name)
            case {"op": "unwatch", "feed": str(name), **rest} if not rest:
                self._unwatch(name)
            case {"op": "took", "feed": str(name), "n": int(n), **rest} if not rest:
                if self._drawing.get(name) == n:
                    del self._drawing[name]
                    self._wake.set()
            case {"op": "call", "id": int(number), "verb": str(verb), **rest} if set(rest) <= {"args"}:
                self._call(number, verb, rest.get("args", {}))
            case {"op": "hold", "x": x, "y": y, "turn": turn, **rest} if not rest:
                self._hold_velocity(*_velocity(x=x, y=y, turn=turn))
            case {"op": "release", **rest} if not rest:
                self._run_latest(lambda: self._hold.release(self))
            case _:
                raise BadMessageError(f"not a valid message: {json.dumps(message)[:200]}")

    def _watch(self, name: str) -> None:
        if name in self._watched:
            return
        if len(self._watched) >= MOST_FEEDS:
            raise BadMessageError(f"a page can watch at most {MOST_FEEDS} feeds")
        self._watched.add(name)

        def watch() -> None:
            try:
                feed = self._open[name] = self._feeds.find(name)
                feed.watch(self)
            except LookupError as err:
                reason = str(err)
                self._call_soon(lambda: self._not_watched(name, reason))

        self._run_posted(watch)

    def _not_watched(self, name: str, why: str) -> None:
        """Report that a feed cannot be watched; the page may try again afterwards."""
        self._watched.discard(name)
        self._queue({"op": "error", "error": why})

    def _unwatch(self, name: str) -> None:
        if name not in self._watched:
            return
        self._watched.discard(name)
        self._drawing.pop(name, None)

        def unwatch() -> None:
            if name in self._open:
                self._open.pop(name).unwatch(self)
            with self._lock:
                self._news.pop(name, None)

        self._run_posted(unwatch)

    def _hold_velocity(self, x: float, y: float, turn: float) -> None:
        if not self._grant.may_drive:
            raise BadMessageError(f"{_WATCHES}: it may not drive manually")
        arrived = time.monotonic()
        self._run_latest(lambda: self._hold.hold(self, x, y, turn, arrived))

    def _run_latest(self, action: Callable[[], None]) -> None:
        """Run the newest hold or release and drop older ones; at most one waits, and none is refused."""
        with self._lock:
            waits, self._newest_action = self._newest_action is not None, action
        if not waits:
            self._post(self._run_newest)

    def _run_newest(self) -> None:
        """Run on the module's thread."""
        with self._lock:
            action, self._newest_action = self._newest_action, None
        if action is not None:
            action()

    def _run_posted(self, action: Callable[[], Any]) -> None:
        """Run an action on the module's thread; raises `BadMessageError` if too many are queued."""
        if self._posted >= MOST_WAITING:
            raise BadMessageError(f"{MOST_WAITING} messages of this page are queued already")
        with self._lock:
            self._posted += 1

        def run() -> None:
            with self._lock:
                self._posted -= 1
            action()

        self._post(run)

    def _call(self, number: int, verb: str, args: Any) -> None:
        if not isinstance(args, dict):
            raise BadMessageError("args must be an object")
        if self._verbs.is_command(verb) and not self._grant.may_drive:
            self._reply(number, error=f"{_WATCHES}: {verb} is not allowed")
            return
        stops = self._verbs.is_stop(verb)
        most = MOST_STOPS if stops else MOST_CALLS
        if len(self._calls) >= most:
            self._reply(number, error=f"{most} calls of this page are pending already")
            return
        call = asyncio.create_task(self._run(number, verb, args))
        for calls in (self._calls, self._stops) if stops else (self._calls,):
            calls.add(call)
            call.add_done_callback(calls.discard)

    async def _run(self, number: int, verb: str, args: dict[str, Any]) -> None:
        try:
            value = await asyncio.wrap_future(self._verbs.begin(verb, args, self.who))
        except VerbError as err:
            self._reply(number, error=str(err))
        except Exception as err:
            _log.exception("%s: %s", self.who, verb)
            self._reply(number, error=f"{type(err).__name__}: {err}")
        else:
            self._reply(number, value=value)

    def _reply(self, number: int, *, value: Any = None, error: str = "") -> None:
        self._queue({"op": "reply", "id": number, "ok": not error, **({"error": error} if error else {"value": value})})


def _parsed(message: Any) -> dict[str, Any]:
    """The JSON object of a frame; raises `BadMessageError`."""
    text = message.get("text")
    if not isinstance(text, str):
        raise BadMessageError("messages must be JSON in text frames")
    try:
        message_ = _DECODER.decode(text)
    except (ValueError, RecursionError) as err:
        raise BadMessageError(f"not JSON: {str(err)[:200]}") from None
    if not isinstance(message_, dict):
        raise BadMessageError("a message must be a JSON object")
    return message_


def _refused_number(word: str) -> float:
    raise ValueError(f"{word} is not a number in JSON")


_DECODER = json.JSONDecoder(parse_constant=_refused_number)


def _velocity(**parts: Any) -> list[float]:
    """Return the numbers of a hold; raises `BadMessageError`."""
    checked = []
    for name, value in parts.items():
        try:
            checked.append(_check_speed(value))
        except ValueError as err:
            raise BadMessageError(f"hold: {name} {err}, not {value!r:.80}") from None
    return checked

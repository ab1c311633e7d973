"""Serves one page over its WebSocket, on the server's event loop; see docs/operate/console_protocol.md."""

from __future__ import annotations

import asyncio
import json
import logging
import re
from collections.abc import Callable
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from bridge.clock import steady
from bridge.web.feeds.feed import Feed, Feeds
from bridge.web.outbox import MOST_ACTIONS, MOST_REPLIES, PageOutbox, Post, PostedActions
from bridge.web.serving.access import Grant
from bridge.web.serving.login import who
from bridge.web.verbs.hold import HandDriving
from bridge.web.verbs.verbs import VerbError, Verbs, number_between

_log = logging.getLogger("midspan.web")

MOST_FEEDS = 64
MOST_CALLS, MOST_STOPS = 16, 64
"""Maximum number of a page's pending calls, for calls and for stops; further ones are refused."""
MOST_ERRORS = 20
_POLICY = 1008  # WebSocket's close code for a policy violation (RFC 6455, 7.4.1)
_check_speed = number_between(-1e9, 1e9)
_WATCHES = "this page has the role 'watch'"


class BadMessageError(ValueError):
    """A page's message is invalid; the text is the reason."""


class PageCalls:
    """The pending calls of one page, on the server's event loop. Stops of robots are never canceled."""

    def __init__(self, verbs: Verbs, who: str) -> None:
        self._verbs, self._who = verbs, who
        self._pending: set[asyncio.Task[None]] = set()
        self._stops: set[asyncio.Task[None]] = set()

    def begin(self, number: int, verb: str, args: dict[str, Any], outbox: PageOutbox) -> None:
        """Begin a call, whose reply goes to the outbox; refuse the call if too many are pending."""
        stops = self._verbs.is_stop(verb)
        most = MOST_STOPS if stops else MOST_CALLS
        if len(self._pending) >= most:
            outbox.queue(_reply(number, error=f"{most} calls of this page are already pending"))
            return
        call = asyncio.create_task(self._run(number, verb, args, outbox))
        for calls in (self._pending, self._stops) if stops else (self._pending,):
            calls.add(call)
            call.add_done_callback(calls.discard)

    async def _run(self, number: int, verb: str, args: dict[str, Any], outbox: PageOutbox) -> None:
        try:
            value = await asyncio.wrap_future(self._verbs.begin(verb, args, self._who))
        except VerbError as err:
            outbox.queue(_reply(number, error=str(err)))
        except Exception as err:
            _log.exception("%s: %s", self._who, verb)
            outbox.queue(_reply(number, error=f"{type(err).__name__}: {err}"))
        else:
            outbox.queue(_reply(number, value=value))

    def cancel(self) -> None:
        """Cancel the pending calls except stops; calls that the module's thread has started continue."""
        for call in self._pending - self._stops:
            call.cancel()


def _reply(number: int, *, value: Any = None, error: str = "") -> dict[str, Any]:
    return {"op": "reply", "id": number, "ok": not error, **({"error": error} if error else {"value": value})}


class Page:
    """Serves one socket until it closes, on the server's event loop; only ``_open`` belongs to the module's thread."""

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
        self._socket, self._grant, self._feeds, self._verbs, self._hold = socket, grant, feeds, verbs, hold
        user = who(grant, f"{socket.client.host}:{socket.client.port}" if socket.client else "a page")
        self._outbox = PageOutbox(user)
        self._outbox.queue({**hello, "role": grant.role, "who": grant.name})
        self._actions = PostedActions(post)
        self._post = post
        self._calls = PageCalls(verbs, user)
        self._watched: set[str] = set()  # feeds that the page has requested; used on the server's event loop
        self._open: dict[str, Feed] = {}  # feeds that are watched for the page; used on the module's thread
        self._errors = 0
        self._pressed: float | None = None  # when a control was pressed; None: released

    async def serve(self) -> None:
        """Serve the page until the socket closes, which also ends the page's hold and feeds."""
        sender = asyncio.create_task(self._outbox.send_to(self._socket))
        try:
            await self._receive()
        except (WebSocketDisconnect, RuntimeError):  # starlette raises them after the page has closed the socket
            pass
        finally:
            self._post(self._unwatch_all)
            sender.cancel()
            self._calls.cancel()

    def _unwatch_all(self) -> None:
        self._hold.release(self._outbox)
        while self._open:
            self._open.popitem()[1].unwatch(self._outbox)

    async def _receive(self) -> None:
        while self._socket.application_state is WebSocketState.CONNECTED:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            try:
                self._handle(_parse(message))
            except BadMessageError as err:
                self._errors += 1
                self._outbox.queue({"op": "error", "error": str(err)})
            full = self._outbox.full
            if self._errors > MOST_ERRORS or full:
                reason = f"the page has not read {MOST_REPLIES} replies" if full else f"{MOST_ERRORS} invalid messages"
                _log.warning("%s: closing its socket: %s", self._outbox.who, reason)
                await self._socket.close(_POLICY)
                return

    def _handle(self, message: dict[str, Any]) -> None:
        match message:
            case {"op": "watch", "feed": str(name), **rest} if not rest:
                self._watch(name)
            case {"op": "unwatch", "feed": str(name), **rest} if not rest:
                self._unwatch(name)
            case {"op": "took", "feed": str(name), "n": int(n), **rest} if not rest:
                self._outbox.drawn(name, n)
            case {"op": "call", "id": int(number), "verb": str(verb), **rest} if set(rest) <= {"args"}:
                self._call(number, verb, rest.get("args", {}))
            case {"op": "hold", "x": x, "y": y, "turn": turn, **rest} if not rest:
                self._hold_velocity(*_velocity(x=x, y=y, turn=turn))
            case {"op": "release", **rest} if not rest:
                self._pressed = None
                self._actions.run_latest(lambda: self._hold.release(self._outbox))
            case _:
                raise BadMessageError(f"not a valid message: {json.dumps(message)[:200]}")

    def _watch(self, name: str) -> None:
        if name in self._watched:
            return
        if len(self._watched) >= MOST_FEEDS:
            raise BadMessageError(f"a page can watch at most {MOST_FEEDS} feeds")
        self._watched.add(name)
        # a value that was sent after the page had stopped watching was not drawn, and must not delay the next one
        self._outbox.unwatched(name)

        def watch() -> None:
            try:
                feed = self._open[name] = self._feeds.find(name)
                feed.watch(self._outbox)
            except LookupError as err:
                reason = str(err)
                self._outbox.call_soon(lambda: self._refuse_feed(name, reason))

        self._run_posted(watch)

    def _refuse_feed(self, name: str, why: str) -> None:
        """Report to the page that a feed cannot be watched; the page may then try again."""
        self._watched.discard(name)
        self._outbox.queue({"op": "error", "error": why})

    def _unwatch(self, name: str) -> None:
        if name not in self._watched:
            return
        self._watched.discard(name)
        self._outbox.unwatched(name)

        def unwatch() -> None:
            if name in self._open:
                self._open.pop(name).unwatch(self._outbox)
            self._outbox.discard(name)

        self._run_posted(unwatch)

    def _hold_velocity(self, x: float, y: float, turn: float) -> None:
        if not self._grant.may_drive:
            raise BadMessageError(f"{_WATCHES}: it may not drive manually")
        arrived = steady()
        pressed = self._pressed = arrived if self._pressed is None else self._pressed
        self._actions.run_latest(lambda: self._hold.hold(self._outbox, x, y, turn, arrived, pressed))

    def _run_posted(self, action: Callable[[], Any]) -> None:
        """Run an action on the module's thread; raises `BadMessageError` if too many are queued."""
        if not self._actions.run(action):
            raise BadMessageError(f"{MOST_ACTIONS} messages of this page are already queued")

    def _call(self, number: int, verb: str, args: Any) -> None:
        if not isinstance(args, dict):
            raise BadMessageError("args must be an object")
        if self._verbs.is_command(verb) and not self._grant.may_drive:
            self._outbox.queue(_reply(number, error=f"{_WATCHES}: {verb} is not allowed"))
        elif verb == "ping" and not args:  # at once, because a page without a reply counts its connection as lost
            self._outbox.queue(_reply(number))
        else:
            self._calls.begin(number, verb, args, self._outbox)


def _parse(message: Any) -> dict[str, Any]:
    """Return the JSON object of a frame; raises `BadMessageError`."""
    text = message.get("text")
    if not isinstance(text, str):
        raise BadMessageError("messages must be JSON in text frames")
    try:
        message_ = _DECODER.decode(text)
        if _SURROGATE.search(text):  # half of a pair cannot be sent to a page again
            json.dumps(message_, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as err:  # UnicodeEncodeError is a ValueError
        raise BadMessageError(f"not JSON: {str(err)[:200]}") from None
    if not isinstance(message_, dict):
        raise BadMessageError("a message must be a JSON object")
    return message_


def _refused_number(word: str) -> float:
    raise ValueError(f"{word} is not a number in JSON")


_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_DECODER = json.JSONDecoder(parse_constant=_refused_number)


def _velocity(**parts: Any) -> list[float]:
    """Return the velocity of a ``hold`` message; raises `BadMessageError`."""
    checked = []
    for name, value in parts.items():
        try:
            checked.append(_check_speed(value))
        except ValueError as err:
            raise BadMessageError(f"hold: {name} {err}, not {value!r:.80}") from None
    return checked

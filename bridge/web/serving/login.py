"""The login page, its cookie, and the guard in front of all other routes."""

from __future__ import annotations

import asyncio
import json
import logging
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

from bridge.web.serving.access import LOGIN_SECONDS, Access, Grant, WrongTokenError, sender
from bridge.web.serving.page_files import STATIC

_log = logging.getLogger("midspan.web")

OPEN = frozenset({"/login", "/login/login.js", "/login/login.css", "/style.css", "/icon.svg", "/healthz", "/readyz"})
"""Paths that need no authentication."""
MOST_BODY = 1024
_BODY_SECONDS = 5.0
_WHO = "login required: open /login in a browser, send 'Authorization: Bearer TOKEN', or use a client certificate"


class LoginGuard:
    """Passes authenticated requests on, with the grant in their state; other requests only for the paths in `OPEN`."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        state = scope.setdefault("state", {})
        path = scope["path"] if scope["type"] == "http" else ""
        grant: Grant | None = None
        refusal: Response = PlainTextResponse(f"{_WHO}\n", 401)
        try:
            grant = self._access.grant(headers, state.get("certificate", ""), address_of(scope))
            if path == "/":
                refusal = RedirectResponse(f"{self._access.prefix}/login", 303)
        except WrongTokenError as err:
            refusal = PlainTextResponse(f"{err}\n", 429 if err.wait else 401, err.headers)
        if grant is None and path not in OPEN:
            await _refuse(scope, receive, send, refusal)
            return
        state["grant"] = grant
        await self._app(scope, receive, send)


async def _refuse(scope: Scope, receive: Receive, send: Send, answer: Response) -> None:
    if scope["type"] == "websocket":
        await WebSocket(scope, receive, send).send_denial_response(answer)
    else:
        await answer(scope, receive, send)


def address_of(scope: Scope) -> str:
    """Return the client's address."""
    return str((scope.get("client") or ("?",))[0])


def who(grant: Grant, address: str) -> str:
    """Return a client's description for the log."""
    return f"{grant.name} at {address}" if grant.name else address


class Login:
    """The routes with which a browser logs in and out."""

    def __init__(self, access: Access) -> None:
        self._access = access
        self.routes = [
            Route("/login", self._page, methods=["GET"]),
            Route("/login", self._login, methods=["POST"]),
            Route("/logout", self._logout, methods=["POST"]),
            Route("/whoami", self._whoami, methods=["GET"]),
        ]

    async def _page(self, _request: Request) -> Response:
        return Response((STATIC / "login" / "login.html").read_bytes(), media_type="text/html; charset=utf-8")

    async def _login(self, request: Request) -> Response:
        if "origin" not in request.headers:  # `server.refusal` has checked its value
            return PlainTextResponse("only this console's own page may log in\n", 403)
        try:
            async with asyncio.timeout(_BODY_SECONDS):
                token = _token(await _body(request))
        except (ValueError, TimeoutError):
            return PlainTextResponse('send {"token": "..."}\n', 400)
        address = address_of(request.scope)
        try:
            grant, cookie = self._access.login(token, address, sender(request.headers))
        except WrongTokenError as err:
            return PlainTextResponse(f"{err}\n", 429 if err.wait else 403, err.headers)
        _log.info("%s logged in, role %s", who(grant, address), grant.role)
        answer = JSONResponse({"name": grant.name, "role": grant.role})
        name = self._access.cookie
        answer.set_cookie(name, cookie, LOGIN_SECONDS, path="/", secure=True, httponly=True, samesite="strict")
        return answer

    async def _logout(self, request: Request) -> Response:
        if "origin" not in request.headers:
            return PlainTextResponse("only this console's own page may log out\n", 403)
        answer = PlainTextResponse("logged out\n")
        answer.delete_cookie(self._access.cookie, path="/", secure=True, httponly=True, samesite="strict")
        return answer

    async def _whoami(self, request: Request) -> Response:
        grant: Grant = request.scope["state"]["grant"]
        return JSONResponse({"name": grant.name, "role": grant.role})


async def _body(request: Request) -> bytes:
    """Return the body; raises `ValueError` if it is too long."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_BODY:
            raise ValueError("too long")
    return body


def _token(body: bytes) -> str:
    """Return the token in a body; raises `ValueError`."""
    try:
        document: Any = json.loads(body)
    except RecursionError:
        raise ValueError("too deep") from None
    match document:
        case {"token": str(token)}:
            return token
        case _:
            raise ValueError("no token")

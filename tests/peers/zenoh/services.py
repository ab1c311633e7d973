"""Services of the programs in `tests.peers.zenoh.programs`; see `tests.peers.peer` for the commands.

Written from the plugins' sources (zenoh-plugin-ros2dds of August 2026: ``route_service_srv.rs``,
``route_service_cli.rs``; zenoh-plugin-ros1 of May 2025: ``abstract_bridge.rs``).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import zenoh

TIMEOUT = 30.0
"""Timeout of these programs' queries in seconds; the plugins' defaults are 5 and 10."""

TYPES = {
    "std_srvs/SetBool": ("bool data\n", "bool success\nstring message\n"),
    "std_srvs/Trigger": ("", "bool success\nstring message\n"),
}
MD5 = {
    "std_srvs/SetBool": "09fb03525b03e7ea1fd3992bafd87e16",
    "std_srvs/Trigger": "937c9679a518e3a18d831e57125ea522",
}


class Wire:
    """The format of a dialect's requests and replies.

    Args:
        encode: converts a type's fields to bytes.
        decode: converts bytes to a type's fields.
        failed: returns a bridge's reply to the error text of its server; None if bridges do not reply to errors.
        takes: whether a bridge forwards a request.
        attachment: attachment of each request.
    """

    def __init__(
        self,
        encode: Callable[[str, dict[str, Any]], bytes],
        decode: Callable[[str, bytes], Any],
        failed: Callable[[str], bytes | None],
        takes: Callable[[zenoh.Query], bool],
        attachment: Callable[[], bytes | None],
    ) -> None:
        self.encode, self.decode, self.failed, self.takes, self.attachment = encode, decode, failed, takes, attachment


class Serving:
    """A bridge's queryable for a service, whose server gives one answer to all requests."""

    def __init__(self, session: zenoh.Session, key: str, wire: Wire, params: dict[str, Any]) -> None:
        self.key, self.wire, self.type = key, wire, params["type"]
        self.reply, self.error = params.get("reply") or {}, params.get("error", "")
        self.held, self.ended = bool(params.get("held")), False
        self.arrived = threading.Condition()
        self.taken: list[Any] = []
        self.attachments = list[bytes]()
        self.waiting: list[zenoh.Query] = []
        self.queryable = session.declare_queryable(
            key, zenoh.handlers.Callback(self.asked, indirect=False), allowed_origin=zenoh.Locality.REMOTE
        )

    def asked(self, query: zenoh.Query) -> None:
        if not self.wire.takes(query):
            query.drop()
            return
        payload, attached = query.payload, query.attachment
        request = self.wire.decode(f"{self.type}_Request", b"" if payload is None else payload.to_bytes())
        with self.arrived:
            self.taken.append(request)
            self.attachments.append(b"" if attached is None else attached.to_bytes())
            held = self.held
            if held:
                self.waiting.append(query)
            self.arrived.notify_all()
        if not held:
            self.answer(query)

    def answer(self, query: zenoh.Query) -> None:
        data = self.wire.failed(self.error) if self.error else self.wire.encode(f"{self.type}_Response", self.reply)
        if data is None:
            self.waiting.append(query)
            return
        with query:
            query.reply(query.key_expr, data)

    def requests(self, count: int = 1, seconds: float = 40.0) -> list[Any]:
        with self.arrived:
            self.arrived.wait_for(lambda: len(self.taken) >= count or self.ended, seconds)
            return list(self.taken)

    def release(self) -> None:
        with self.arrived:
            self.held, waiting, self.waiting = False, self.waiting, []
        for query in waiting:
            self.answer(query)

    def undeclare(self) -> None:
        self.queryable.undeclare()
        with self.arrived:
            self.ended = True
            self.arrived.notify_all()

    def drop_queries(self) -> None:
        """Drop held queries, because closing the session would wait for them."""
        waiting, self.waiting = self.waiting, []
        for query in waiting:
            query.drop()


class Calling:
    """One query by a bridge, and its first reply."""

    def __init__(
        self, session: zenoh.Session, key: str, wire: Wire, type_: str, request: dict[str, Any] | bytes | None
    ) -> None:
        self.wire, self.type = wire, type_
        self.answers: list[zenoh.Reply] = []
        self.ended = threading.Event()
        self.token = zenoh.CancellationToken()
        payload = wire.encode(f"{type_}_Request", request) if isinstance(request, dict) else request
        session.get(
            key,
            zenoh.handlers.Callback(self.answers.append, self.ended.set, indirect=False),
            payload=payload,
            attachment=wire.attachment(),
            timeout=TIMEOUT,
            allowed_destination=zenoh.Locality.REMOTE,
            cancellation_token=self.token,
        )

    def result(self, seconds: float = 20.0) -> dict[str, Any]:
        if not self.ended.wait(seconds):
            return {"done": False, "reply": None, "error": ""}
        if not self.answers:
            return {"done": True, "reply": None, "error": "no reply"}
        assert len(self.answers) == 1, "more than one answer"
        answer = self.answers[0]
        if answer.ok is None:
            return {"done": True, "reply": None, "error": answer.err.payload.to_bytes().decode()}
        data = answer.ok.payload.to_bytes()
        return {"done": True, "reply": self.wire.decode(f"{self.type}_Response", data), "error": ""}

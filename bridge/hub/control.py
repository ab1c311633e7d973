"""The control plane: requests and replies in JSON between Midspan's programs, as zenoh queries.

A worker replies on ``@midspan/<domain>/<daemon>/<worker>/<verb>``. The reply is ``{"value": ...}`` or
``{"error": "..."}``, with ``wire``, the version of `bridge.hub.wire.version`, and ``daemon``, the identity of the
worker's daemon (`bridge.hub.daemons`). Subscribers to ``**`` do not receive keys that start with ``@``.
"""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from threading import BoundedSemaphore
from typing import Any

import zenoh

from bridge.concurrency import WorkerPool
from bridge.hub.daemons import DaemonIdentity, read_identity
from bridge.hub.errors import HubError
from bridge.hub.graph.tokens import MIDSPAN_SPACE
from bridge.hub.opening import prepare_to_send
from bridge.hub.wire.version import WIRE, refusal
from bridge.hub.zenoh_compat import undeclare

_log = logging.getLogger(__name__)
Handler = Callable[[dict[str, Any]], Any]

RECORDED = {"recorded": True}
"""A recorder's answer to ``halt``: the recorder stops nothing, but saves the messages that led to the halt."""

MANUAL_DRIVING_HALTED = {"halted": True, "base": False}
"""The answer to ``halt`` of a worker whose users may drive manually: it has ended that, but has no base itself."""

WHO = {"who": True}
"""Parameters of any verb that request only the identity of the worker's daemon."""

EVERY_DOMAIN = "*"
"""The domain of a `Control` that answers the queries of all domains."""

_MAX_PENDING = 64
_MAX_REQUEST = 1 << 20
_MAX_ANSWERS = 1000
_THREADS = 2


@dataclass(frozen=True, slots=True)
class WorkerAnswer:
    """One worker's answer; ``error`` is "" if ``value`` is valid.

    ``session`` is the id of the worker's session; ``identity`` identifies its daemon, None if the worker's release does
    not send it.
    """

    daemon: str
    worker: str
    value: Any
    error: str = ""
    session: str = field(default="", compare=False)
    identity: DaemonIdentity | None = field(default=None, compare=False)


class Control:
    """Answers the queries to one worker. Handlers run on separate threads, never on zenoh's threads."""

    def __init__(
        self,
        session: zenoh.Session,
        domain: int | str,
        daemon: str,
        worker: str,
        identity: DaemonIdentity | None = None,
    ) -> None:
        self._session = session
        self._envelope: dict[str, Any] = {"wire": WIRE}
        if identity is not None:
            self._envelope["daemon"] = identity.as_dict()
        self._space = f"{MIDSPAN_SPACE}/{domain}"
        self._me = f"{daemon}/{worker}"
        self._pending = BoundedSemaphore(_MAX_PENDING)
        self._pool = WorkerPool(_THREADS, "hub-control")
        self._serving: list[zenoh.Queryable[None]] = []

    def serve(self, verb: str, handler: Handler) -> Callable[[], None]:
        """Answer a verb until the returned function or `close` is called.

        The handler receives the parameters, and returns a value that JSON can represent.
        """
        key = f"{self._space}/{self._me}/{verb}"

        def enqueue(query: zenoh.Query) -> None:
            if self._pending.acquire(blocking=False):
                self._pool.submit(lambda: self._reply(query, key, handler))
            else:
                _reply(query, key, self._error("too many requests at once; try again later"))

        asked = zenoh.handlers.Callback(enqueue, indirect=False)
        serving = self._session.declare_queryable(key, asked, complete=True)
        self._serving.append(serving)
        return partial(self._withdraw, serving)

    def close(self) -> None:
        """Stop answering and end the threads. Safe to call twice."""
        undeclare(*self._serving)
        self._pool.close(1.0)

    def _withdraw(self, serving: zenoh.Queryable[None]) -> None:
        with contextlib.suppress(ValueError):
            self._serving.remove(serving)
        undeclare(serving)

    def _reply(self, query: zenoh.Query, key: str, handler: Handler) -> None:
        try:
            _reply(query, key, self._answer(handler, query))
        finally:
            self._pending.release()

    def _answer(self, handler: Handler, query: zenoh.Query) -> bytes:
        try:
            params = _params(query)
            value = None if params == WHO else handler(params)
            return json.dumps({**self._envelope, "value": value}).encode()
        except HubError as err:
            return self._error(str(err))
        except Exception as err:
            # a failed handler must neither leave the query without an answer nor end the thread
            _log.warning("query %s failed", query.key_expr, exc_info=True)
            return self._error(str(err) or type(err).__name__)

    def _error(self, text: str) -> bytes:
        return json.dumps({**self._envelope, "error": text}).encode()


def ask(
    session: zenoh.Session, domain: int, verb: str, params: dict[str, Any], daemon: str, worker: str, timeout: float
) -> list[WorkerAnswer]:
    """Query all workers that serve a verb; return when all have answered, or after ``timeout`` seconds."""
    replies = session.get(
        f"{MIDSPAN_SPACE}/{domain}/{daemon}/{worker}/{verb}",
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=timeout,
        payload=json.dumps(params).encode(),
    )
    answers: list[WorkerAnswer] = []
    for reply in replies:
        if reply.ok is not None and len(answers) < _MAX_ANSWERS:
            answers.append(replace(_read(reply.ok), session=_session(reply)))
    return answers


def _session(reply: zenoh.Reply) -> str:
    return "" if reply.replier_id is None else str(reply.replier_id.zid)


def _params(query: zenoh.Query) -> dict[str, Any]:
    payload = query.payload
    if payload is None:
        return {}
    if len(payload) > _MAX_REQUEST:
        raise HubError(f"request of {len(payload)} bytes, more than {_MAX_REQUEST}")
    try:
        params = json.loads(payload.to_bytes())
    except (ValueError, RecursionError):
        params = None
    if not isinstance(params, dict):
        raise HubError("a request's parameters must be a JSON object")
    return params


def _reply(query: zenoh.Query, key: str, answer: bytes) -> None:
    prepare_to_send(len(answer))
    try:
        with query:
            query.reply(key, answer)
    except zenoh.ZError as err:
        _log.debug("the client of %s has left: %s", key, err)


def _read(sample: zenoh.Sample) -> WorkerAnswer:
    parts = str(sample.key_expr).split("/")
    daemon, worker = parts[-3], parts[-2]
    try:
        answer = json.loads(sample.payload.to_bytes())
        if why := refusal(answer.get("wire")):
            return WorkerAnswer(daemon, worker, None, f"{daemon}/{worker} cannot be understood: {why}")
        identity = read_identity(answer.get("daemon"))
        return WorkerAnswer(daemon, worker, answer.get("value"), str(answer.get("error", "")), identity=identity)
    except (ValueError, AttributeError, RecursionError):
        return WorkerAnswer(daemon, worker, None, "the answer is not JSON")

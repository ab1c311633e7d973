"""A zenoh end: queries with an attachment as large as rmw_zenoh's, between peers with a direct link.

An action consists of queries: for the goal and then for its result; the result of a held goal is sent when a third
query cancels it. Usage: ``python -m benchmarks.roundtrips.zenoh_end ROUTER``.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh
from typing_extensions import override

from benchmarks.roundtrips.end import MAP_SIDE, End
from bridge.hub.wire.keys import ATTACHMENT_SIZE
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree

SECONDS = 30.0
SMALL, GOAL = bytes(16), bytes(120)
"""Payloads as large as those of SetBool and of NavigateToPose's goal."""


class ZenohEnd(End):
    """A program with one zenoh session."""

    def __init__(self, router: str) -> None:
        tree = session_tree(router, shared_memory=True, max_payload=MAX_PAYLOAD)
        self._session = zenoh.open(make_config(tree, None))
        self._queryables: list[Any] = []
        self._asking: list[Any] = []

    @override
    def serve(self, prefix: str) -> None:
        grid = bytes(MAP_SIDE * MAP_SIDE + 100)
        for name, reply in (("call", SMALL), ("map", grid), ("go/send", SMALL), ("go/result", SMALL)):
            self._serve(f"{prefix}/{name}", _answerer(reply))
        self._serve(f"{prefix}/hold/send", _answerer(SMALL))
        self._serve(f"{prefix}/hold/result", self._asking.append)
        self._serve(f"{prefix}/hold/cancel", self._cancel)

    def _serve(self, name: str, asked: Callable[[Any], None]) -> None:
        handler: Any = zenoh.handlers.Callback(asked, indirect=False)
        self._queryables.append(self._session.declare_queryable(name.strip("/"), handler, complete=True))

    def _cancel(self, query: Any) -> None:
        _answerer(SMALL)(query)
        query.drop()
        _answerer(SMALL)(self._asking.pop())

    @override
    def wait_for(self, prefix: str) -> None:
        # also waits until the direct link exists
        end = time.monotonic() + SECONDS
        while not self._session.info.peers_zid() and time.monotonic() < end:
            time.sleep(0.02)
        while time.monotonic() < end:
            try:
                self.call(prefix)
                break
            except RuntimeError:
                time.sleep(0.05)

    @override
    def call(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        self._wait(self._ask(f"{prefix}/call", SMALL))
        return time.perf_counter_ns() - began

    @override
    def get_map(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        self._wait(self._ask(f"{prefix}/map", SMALL))
        return time.perf_counter_ns() - began

    @override
    def run_goal(self, prefix: str) -> int:
        began = time.perf_counter_ns()
        self._wait(self._ask(f"{prefix}/go/send", GOAL))
        self._wait(self._ask(f"{prefix}/go/result", SMALL))
        return time.perf_counter_ns() - began

    @override
    def cancel_goal(self, prefix: str) -> int:
        self._wait(self._ask(f"{prefix}/hold/send", GOAL))
        result = self._ask(f"{prefix}/hold/result", SMALL)
        time.sleep(0.02)
        began = time.perf_counter_ns()
        self._ask(f"{prefix}/hold/cancel", SMALL)
        self._wait(result)
        return time.perf_counter_ns() - began

    def _ask(self, name: str, payload: bytes) -> _PendingReply:
        pending = _PendingReply()
        self._session.get(
            name.strip("/"),
            zenoh.handlers.Callback(pending.replied, pending.ended.set, indirect=False),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=SECONDS,
            payload=payload,
            attachment=bytes(ATTACHMENT_SIZE),
            express=True,
        )
        return pending

    @staticmethod
    def _wait(asked: _PendingReply) -> None:
        asked.ended.wait(SECONDS)
        if not asked.replies:
            raise RuntimeError("no answer")

    @override
    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


class _PendingReply:
    def __init__(self) -> None:
        self.replies: list[bytes] = []
        self.ended = threading.Event()

    def replied(self, reply: Any) -> None:
        """Record a reply."""
        if reply.ok is not None:
            self.replies.append(reply.ok.payload.to_bytes())
            self.ended.set()


def _answerer(reply: bytes) -> Callable[[Any], None]:
    def answer(query: Any) -> None:
        query.reply(query.key_expr, reply, attachment=bytes(ATTACHMENT_SIZE))

    return answer


if __name__ == "__main__":
    ZenohEnd(sys.argv[1]).run()

"""A master's calls to nodes: ``publisherUpdate``, ``paramUpdate`` and ``shutdown`` of the slave API.

Each address has its own queue, which one thread of a pool empties in order; a newer value replaces a queued older one.
A node that does not answer in time keeps its queue, and is called again later on a thread of another pool, so that it
does not delay other nodes. A node that refuses the connection has ended, and its queue is dropped; so is the queue of
an address whose response is invalid, or that has failed more than `_TRIES` times in a row.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

from bridge.adapters.ros1.master.registrations import Link
from bridge.adapters.ros1.node.slave import REPEATING_MASTER
from bridge.adapters.ros1_peers import (
    MAX_NODE_ANSWER,
    ExhaustedError,
    RefusedError,
    Ros1Error,
    UnreachableError,
    XmlRpcClient,
)
from bridge.concurrency import DelayedCalls, WorkerPool

_log = logging.getLogger("midspan.ros1.master")

CALLER = "/master"
_SECONDS = 5.0
_THREADS, _SLOW_THREADS = 32, 8
_RETRY_SECONDS = (1.0, 2.0, 5.0)
_TRIES = 60
_MAX_QUEUED = 10_000
"""Maximum number of calls that wait for one address; beyond it, the oldest is dropped."""


class _Call(NamedTuple):
    method: str
    params: tuple[Any, ...]
    subscriber: Link | None
    """The subscriber of a parameter, which is dropped if it rejects the update; None for other calls."""

    subscribed_key: str


class _Queue:
    """The calls that wait for one address; a newer call replaces a waiting call with the same key."""

    def __init__(self) -> None:
        self.calls: dict[tuple[str, ...], _Call] = {}
        self.failures = 0


class NodeCalls:
    """Queues the calls to nodes, and makes them.

    Args:
        rejected: called with a subscriber of a parameter that rejects an update, and with the subscribed key.
    """

    def __init__(self, rejected: Callable[[Link, str], None]) -> None:
        self._rejected = rejected
        self._lock = threading.Lock()
        self._queues: dict[str, _Queue] = {}
        self._pool = WorkerPool(_THREADS, "midspan-ros1-node-calls")
        self._slow_pool = WorkerPool(_SLOW_THREADS, "midspan-ros1-slow-nodes")
        self._retries = DelayedCalls("midspan-ros1-retries")

    def publisher_update(self, api: str, topic: str, publishers: list[str]) -> None:
        """Report the publishers of a topic to a subscriber."""
        call = _Call("publisherUpdate", (CALLER, topic, publishers), None, "")
        self._put(api, ("topic", topic), call)

    def param_update(
        self, subscriber: Link, subscribed_key: str, key: str, value: Any, *, repeated: bool = False
    ) -> None:
        """Report a parameter's value to a subscriber; ``repeated`` if no program has just set it."""
        caller = REPEATING_MASTER if repeated else CALLER
        call = _Call("paramUpdate", (caller, key, value), subscriber, subscribed_key)
        self._put(subscriber.api, ("parameter", key, subscribed_key, subscriber.node), call)

    def shut_down(self, api: str, node: str, reason: str) -> None:
        """Ask a node to shut down."""
        call = _Call("shutdown", (CALLER, f"[{node}] Reason: {reason}"), None, "")
        self._put(api, ("shutdown", node), call)

    def after(self, seconds: float, call: Callable[[], None]) -> None:
        """Run ``call`` after ``seconds``."""
        self._retries.after(seconds, call)

    def drop(self, api: str) -> None:
        """Drop the calls that wait for a dead node."""
        with self._lock:
            queue = self._queues.get(api)
            if queue is not None:
                queue.calls.clear()

    @property
    def waiting(self) -> int:
        """Number of queued calls."""
        with self._lock:
            return sum(len(queue.calls) for queue in self._queues.values())

    def close(self) -> None:
        """Drop all calls."""
        self._retries.close(0.0)
        for pool in (self._pool, self._slow_pool):
            pool.close()
        with self._lock:
            for queue in self._queues.values():
                queue.calls.clear()
            self._queues.clear()

    def _put(self, api: str, key: tuple[str, ...], call: _Call) -> None:
        with self._lock:
            queue = self._queues.get(api)
            idle = queue is None
            if queue is None:
                queue = self._queues[api] = _Queue()
            queue.calls.pop(key, None)  # the newer call goes to the end, so that the last value of each parameter wins
            queue.calls[key] = call
            if len(queue.calls) > _MAX_QUEUED:
                dropped = next(iter(queue.calls))
                del queue.calls[dropped]
                _log.warning("too many calls wait for the node at %s; dropped one for %s", api, dropped[1])
        if idle:
            self._pool.submit(lambda: self._drain(api, queue))

    def _drain(self, api: str, queue: _Queue) -> None:
        """Make the queued calls of one address, until none is left or one fails."""
        try:
            client = XmlRpcClient(api, _SECONDS, MAX_NODE_ANSWER)
        except Ros1Error as err:
            self._failed(api, queue, err)
            return
        with contextlib.closing(client):
            while (key_and_call := self._next(api, queue)) is not None:
                key, call = key_and_call
                try:
                    client.call(call.method, *call.params)
                except RefusedError:
                    if call.subscriber is not None:
                        self._rejected(call.subscriber, call.subscribed_key)
                except Ros1Error as err:
                    if call.method != "shutdown":
                        self._requeue(queue, key, call)
                    self._failed(api, queue, err)
                    return
                queue.failures = 0

    def _next(self, api: str, queue: _Queue) -> tuple[tuple[str, ...], _Call] | None:
        with self._lock:
            if not queue.calls:
                self._remove(api, queue)
                return None
            key = next(iter(queue.calls))
            return key, queue.calls.pop(key)

    def _remove(self, api: str, queue: _Queue) -> None:
        """Remove a queue, unless a later queue has replaced it. The lock is held."""
        if self._queues.get(api) is queue:
            del self._queues[api]

    def _requeue(self, queue: _Queue, key: tuple[str, ...], call: _Call) -> None:
        """Put a failed call back at the front, unless a newer call has replaced it."""
        with self._lock:
            if key not in queue.calls:
                queue.calls = {key: call, **queue.calls}

    def _failed(self, api: str, queue: _Queue, err: Ros1Error) -> None:
        queue.failures += 1
        may_pass = not err.refused if isinstance(err, UnreachableError) else isinstance(err, ExhaustedError)
        final = not may_pass or queue.failures > _TRIES
        with self._lock:
            done = final or not queue.calls
            if done:
                self._remove(api, queue)
        level = logging.INFO if queue.failures == 1 else logging.DEBUG
        _log.log(level, "a call to the node at %s failed%s: %s", api, "" if done else ", and will be repeated", err)
        if not done:
            pause = _RETRY_SECONDS[min(queue.failures, len(_RETRY_SECONDS)) - 1]
            self._retries.after(pause, lambda: self._retry(api, queue))

    def _retry(self, api: str, queue: _Queue) -> None:
        self._slow_pool.submit(lambda: self._drain(api, queue))

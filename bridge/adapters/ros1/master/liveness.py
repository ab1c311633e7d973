"""Removal of dead nodes: those whose slave API no longer answers.

A node that is killed cannot unregister. ``rosmaster`` lists it for ever; subscribers then try to connect to it, and
tools show it. Here each node is asked for its process id now and then. If its machine refuses the connection, its
process has ended. A node that is only unreachable may come back with its network, so it has more time.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from bridge.adapters.ros1.master.node_calls import CALLER
from bridge.adapters.ros1_peers import ExhaustedError, RefusedError, Ros1Error, UnreachableError, ask
from bridge.concurrency import WorkerPool

_log = logging.getLogger("midspan.ros1.master")

UNREACHABLE_SECONDS = 600.0
"""Seconds until a node is removed whose machine does not refuse connections; at least those of a refusing one."""

RESTORED_SECONDS = 3.0
"""Seconds for a node that was restored from the state file, instead of the configured ones."""

_MIN_FAILURES = 3
_TIMEOUT = 2.0
_THREADS = 8
_PERIODS = (0.1, 10.0)
_RESTORED_PERIOD = 1.0
_CHECKS_PER_SECOND = 20.0
_JOIN_SECONDS = 1.0

Nodes = dict[str, str]
"""Names and addresses of the registered nodes."""


@dataclass(slots=True)
class _Failures:
    """Failed checks of one node since its last answer."""

    since: float
    count: int = 0
    seconds: float = 0.0


class Liveness:
    """Checks the registered nodes, and reports the dead ones.

    Args:
        nodes: returns the registered nodes.
        dead: is called with name and address of a dead node.
        seconds: without an answer until a node is dead; 0 if none is to be removed.
    """

    def __init__(self, nodes: Callable[[], Nodes], dead: Callable[[str, str], None], seconds: float) -> None:
        self._nodes, self._dead, self._seconds = nodes, dead, seconds
        self._period = min(max(seconds / 4, _PERIODS[0]), _PERIODS[1])
        self._failures: dict[tuple[str, str], _Failures] = {}
        self._restored: set[tuple[str, str]] = set()
        self._checked: set[tuple[str, str]] = set()
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._pool = WorkerPool(_THREADS, "midspan-ros1-node-checks")
        self._thread = threading.Thread(target=self._run, name="midspan-ros1-liveness", daemon=True)

    def start(self, restored: Nodes) -> None:
        """Start to check; ``restored`` nodes may have ended while the master was not running."""
        self._restored = set(restored.items())
        if self._seconds > 0:
            self._thread.start()

    def close(self) -> None:
        """Stop checking."""
        self._stopping.set()
        self._pool.close()
        if self._thread.is_alive():
            self._thread.join(_JOIN_SECONDS)

    def _run(self) -> None:
        nodes: set[tuple[str, str]] = set()
        while not self._stopping.wait(self._pause(len(nodes))):
            nodes = set(self._nodes().items())
            with self._lock:
                self._failures = {node: failures for node, failures in self._failures.items() if node in nodes}
                self._restored &= nodes
                due = nodes - self._checked
                self._checked |= due
            for node in due:
                self._pool.submit(lambda node=node: self._check(*node))  # type: ignore[misc]

    def _pause(self, count: int) -> float:
        """Return the seconds until the next checks; longer with many nodes."""
        period = min(self._period, _RESTORED_PERIOD) if self._restored else self._period
        return max(period, count / _CHECKS_PER_SECOND)

    def _check(self, name: str, api: str) -> None:
        refused = answered = False
        try:
            ask(api, _TIMEOUT, "getPid", CALLER)
            answered = True
        except (RefusedError, ExhaustedError):  # it answers; or this process lacks descriptors to ask with
            answered = True
        except UnreachableError as err:
            refused = err.refused
        except Ros1Error:  # another program has its port
            refused = True
        self._record((name, api), answered=answered, refused=refused)

    def _record(self, node: tuple[str, str], *, answered: bool, refused: bool) -> None:
        now = time.monotonic()
        with self._lock:
            self._checked.discard(node)
            if answered:
                self._failures.pop(node, None)
                self._restored.discard(node)
                return
            failures = self._failures.setdefault(node, _Failures(now))
            failures.count += 1
            seconds = min(RESTORED_SECONDS, self._seconds) if node in self._restored else self._seconds
            if not refused:
                seconds = max(self._seconds, UNREACHABLE_SECONDS)
            dead = failures.count >= _MIN_FAILURES and now - failures.since >= seconds
        if dead:
            name, api = node
            _log.warning("removed the registrations of the node %s: %s no longer answers", name, api)
            self._dead(name, api)

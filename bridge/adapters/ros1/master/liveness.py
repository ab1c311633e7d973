"""Removes dead nodes: those whose slave API no longer answers.

A node that is killed cannot unregister. ``rosmaster`` lists it forever; subscribers then try to connect to it, and
tools show it. Here each node is asked for its process id now and then. If its machine refuses the connection, its
process has ended. A node that is only unreachable may come back with its network, so it is given more time.

A node that has never answered stays. Its address may lead elsewhere from this machine, for example ``localhost`` or a
host name that only the robot's own machines resolve, while the nodes on those machines reach each other.
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
"""Seconds until a node is removed if its machine does not answer at all, unless a longer time is configured."""

RESTORED_SECONDS = 3.0
"""Seconds until a node restored from the state file is removed if its machine refuses the connection.

A shorter configured time has precedence.
"""

_MIN_FAILURES = 3
_TIMEOUT = 2.0
_THREADS = 8
_PERIODS = (0.1, 10.0)
_HASTY_PERIOD = 1.0
"""Longest time until a new node's first check and, unless there are many nodes, between checks of restored nodes."""

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
        alive: called with a node's name and address each time it answers.
        dead: called with the name and address of a dead node.
        seconds: the time without an answer after which a node counts as dead; 0 to remove none.
    """

    def __init__(
        self, nodes: Callable[[], Nodes], alive: Callable[[str, str], None], dead: Callable[[str, str], None],
        seconds: float,
    ) -> None:  # fmt: skip
        self._nodes, self._alive, self._dead, self._seconds = nodes, alive, dead, seconds
        self._period = min(max(seconds / 4, _PERIODS[0]), _PERIODS[1])
        self._failures: dict[tuple[str, str], _Failures] = {}
        self._answered_nodes: set[tuple[str, str]] = set()
        self._restored: set[tuple[str, str]] = set()
        self._in_check: set[tuple[str, str]] = set()
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._pool = WorkerPool(_THREADS, "midspan-ros1-node-checks")
        self._thread = threading.Thread(target=self._run, name="midspan-ros1-liveness", daemon=True)

    def start(self, restored: Nodes) -> None:
        """Start checking; ``restored`` nodes answered an earlier master, and may have ended while none was running."""
        self._restored = set(restored.items())
        self._answered_nodes = set(restored.items())
        if self._seconds > 0:
            self._thread.start()

    def close(self) -> None:
        self._stopping.set()
        self._pool.close()
        if self._thread.is_alive():
            self._thread.join(_JOIN_SECONDS)

    def _run(self) -> None:
        nodes: set[tuple[str, str]] = set()
        next_round = 0.0
        while not self._stopping.wait(min(self._pause(len(nodes)), _HASTY_PERIOD)):
            previous, nodes = nodes, set(self._nodes().items())
            with self._lock:
                self._failures = {node: failures for node, failures in self._failures.items() if node in nodes}
                self._restored &= nodes
                self._answered_nodes &= nodes
                due = nodes - previous
                if (now := time.monotonic()) >= next_round:
                    pause = self._pause(len(nodes))
                    due, next_round = nodes, now + pause - min(pause, _HASTY_PERIOD) / 2
                due = due - self._in_check
                self._in_check |= due
            for node in due:
                self._pool.submit(lambda node=node: self._check(*node))  # type: ignore[misc]

    def _pause(self, count: int) -> float:
        """Return the seconds until the next checks; longer with many nodes."""
        period = min(self._period, _HASTY_PERIOD) if self._restored else self._period
        return max(period, count / _CHECKS_PER_SECOND)

    def _check(self, name: str, api: str) -> None:
        node = (name, api)
        try:
            ask(api, _TIMEOUT, "getPid", CALLER)
        except RefusedError:  # an error is an answer of the node, too
            self._on_answer(node)
        except ExhaustedError:  # this process has no file descriptor left to connect with
            pass
        except UnreachableError as err:
            self._on_failure(node, refused=err.refused)
        except Ros1Error:  # another program has the node's port
            self._on_failure(node, refused=True)
        else:
            self._on_answer(node)
        finally:
            with self._lock:
                self._in_check.discard(node)

    def _on_answer(self, node: tuple[str, str]) -> None:
        with self._lock:
            self._failures.pop(node, None)
            self._restored.discard(node)
            self._answered_nodes.add(node)
        self._alive(*node)  # each time, because the node may have registered again since its last answer

    def _on_failure(self, node: tuple[str, str], *, refused: bool) -> None:
        now = time.monotonic()
        with self._lock:
            failures = self._failures.setdefault(node, _Failures(now))
            failures.count += 1
            unknown = node not in self._answered_nodes
            seconds = min(RESTORED_SECONDS, self._seconds) if node in self._restored else self._seconds
            if not refused:
                seconds = max(self._seconds, UNREACHABLE_SECONDS)
            dead = failures.count >= _MIN_FAILURES and now - failures.since >= seconds
        if unknown:
            if failures.count == _MIN_FAILURES:
                _log.warning(
                    "the node %s has never answered at %s, so this master cannot detect its exit; if it runs on another"
                    " machine, set ROS_IP or ROS_HOSTNAME there", *node,
                )  # fmt: skip
        elif dead:
            _log.warning("removed the registrations of the node %s: %s no longer answers", *node)
            self._dead(*node)

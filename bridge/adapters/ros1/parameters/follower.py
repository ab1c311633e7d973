"""The thread that shares parameters between ROS 1's parameter server and the hub."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from bridge.adapters.ros1.parameters.mirrored import MirroredNode
from bridge.adapters.ros1.parameters.offered import OfferedNode
from bridge.adapters.ros1.parameters.store import ParameterContext, ParameterServer
from bridge.adapters.ros1_peers import Ros1Error
from bridge.config.sections.routing import ParameterRule
from bridge.hub.endpoints.calls import CallError, Done
from bridge.hub.node import Hub
from bridge.messages.registry import Registry

_log = logging.getLogger(__name__)

PERIOD = 1.0
"""Seconds between two comparisons; the master reports changes in ROS 1 at once, but changes of a ROS 2 node are found
only by a comparison."""

_SETTLE = 0.02
"""Minimum seconds between two comparisons, because several parameters are often set together."""

MAX_JOBS = 1000
"""Maximum number of jobs that wait for the thread; beyond it, calls are rejected, but nodes' replies still queue."""

_BUSY = "too many calls of parameter services wait for ROS 1's parameter server"
_MAX_SHOWN = 20


class ParameterSharing:
    """Applies the rules (at least one) of ``routing.parameters`` while this worker is ``active``."""

    def __init__(
        self, rules: Sequence[ParameterRule], hub: Hub, registry: Registry, store: ParameterServer,
        active: Callable[[], bool], period: float = PERIOD,
    ) -> None:  # fmt: skip
        self._store, self._active, self._period = store, active, period
        nodes = dict.fromkeys(rule.node for rule in rules if rule.owner == "ros1")
        context = ParameterContext(hub, registry, store, self._submit)
        self._offered = [
            OfferedNode([r for r in rules if r.node == node], context, number) for number, node in enumerate(nodes, 1)
        ]
        self._mirrored = [MirroredNode(rule, context, self.compare_soon) for rule in rules if rule.owner == "ros2"]
        self._parts: tuple[OfferedNode | MirroredNode, ...] = (*self._offered, *self._mirrored)
        self._keys = [rule.ros1 for offered in self._offered for rule in offered.rules]
        self._watched = [rule.ros1 for rule in rules if rule.owner == "ros2"]
        self._jobs: deque[Callable[[], None]] = deque()
        self._wake = threading.Event()
        self._due = True
        self._stopping = threading.Event()
        self._trouble = ""
        self._thread = threading.Thread(target=self._run, name="midspan-ros1-parameters", daemon=True)
        self._thread.start()

    def compare_soon(self) -> None:
        """Schedule a comparison; may be called from any thread."""
        self._due = True
        self._wake.set()

    def stop(self) -> None:
        """Leave the hub, and delete the copies on ROS 1's parameter server. Safe to call twice."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(5.0)

    def warnings(self) -> list[str]:
        """Return the problems, for the status document."""
        warnings = [self._trouble] if self._trouble else []
        for part in self._parts:
            warnings += [f"parameter {name}: {reason}" for name, reason in sorted(dict(part.troubles).items())]
        hidden = len(warnings) - _MAX_SHOWN
        return [*warnings[:_MAX_SHOWN], *([f"and {hidden} more about parameters"] if hidden > 0 else [])]

    def details(self) -> list[dict[str, Any]]:
        """Return the rules as the status document shows them."""
        rules = [(rule, offered.count, list[str]()) for offered in self._offered for rule in offered.rules]
        rules += [(mirrored.rule, mirrored.count, mirrored.skipped) for mirrored in self._mirrored]
        return [
            {"ros1": rule.ros1, "node": rule.node, "owner": rule.owner, "shared": count, "skipped": skipped}
            for rule, count, skipped in rules
        ]

    def _submit(self, job: Callable[[], None], waits: Done | None) -> None:
        """Run a job on the thread; if its queue is full, a call ends with an error instead."""
        if waits is not None and len(self._jobs) >= MAX_JOBS:
            waits(CallError(_BUSY))
            return
        self._jobs.append(job)
        self._wake.set()

    def _run(self) -> None:
        compare_at = time.monotonic()
        while not self._stopping.is_set():
            self._wake.wait(max(0.0, compare_at - time.monotonic()))
            self._wake.clear()
            while self._jobs and not self._stopping.is_set():
                self._try(self._jobs.popleft())
            if self._due or time.monotonic() >= compare_at:
                self._due = False
                self._try(self._compare)
                self._stopping.wait(_SETTLE)
                compare_at = time.monotonic() + self._period
        self._close()
        while self._jobs:
            self._try(self._jobs.popleft())
        self._store.close()

    def _try(self, job: Callable[[], None]) -> None:
        try:
            job()
        except Ros1Error as err:
            if not self._trouble:
                _log.warning("ROS 1's parameter server does not respond: %s", err)
            self._trouble = f"ROS 1's parameter server does not respond: {err}"
            self._close()
        except Exception as err:
            _log.exception("sharing parameters failed")
            self._trouble = f"sharing parameters failed: {err}"

    def _compare(self) -> None:
        if not self._active():
            self._close()
            return
        trees = self._store.watch([*self._keys, *self._watched])
        self._trouble = ""
        copies = self._store.copies
        stale = [key for key in copies if not any(mirrored.covers(key) for mirrored in self._mirrored)]
        self._store.copy(dict.fromkeys(stale), copies.difference(stale))  # deletes the copies of former rules
        for offered in self._offered:
            offered.follow(trees)
        for mirrored in self._mirrored:
            mirrored.follow()

    def _close(self) -> None:
        """Leave the hub while the network is unreachable or another worker shares the parameters, or at the end."""
        for part in self._parts:
            part.close()

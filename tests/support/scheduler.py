"""Distributes test files to pytest-xdist's processes; tests with limits in seconds run last, few at a time."""

from __future__ import annotations

import os
from typing import Any

from xdist.scheduler import LoadFileScheduling

from tests.support.tiers import alone, has_long_tests

_ALONE = "@alone"
"""Suffix for the separate work unit of those tests of a file that have this marker."""

_BY_SIDE = "tests/contract/"
"""Folder of long files with independent tests, split into one work unit per side, so that no process runs longest."""

_SHARED = "tests/web/browser/"
"""Folder whose files share an expensive rig, and so are one work unit."""

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
TOGETHER = min(3, CORES + 1)
"""Number of concurrent tests once only those with the marker `alone` are left. Each uses half a core, because it waits
for programs."""

_FRONT, _LONG = frozenset({"gw0", "gw1"}), frozenset({"gw2", "gw3"})
"""Processes that take files from the front, and processes that start at the end, with the files of `long` tests."""


class Scheduler(LoadFileScheduling):
    """Assigns files to the processes from both ends; the last busy processes continue with the `alone` tests.

    At most two processes receive files from the front, which start programs, because there are two cores. At most two
    receive files with `long` tests while other files are left, because `long` tests use a whole core for minutes.
    """

    def _split_scope(self, nodeid: str) -> str:
        file, _, test = nodeid.partition("::")
        name, _, side = test.partition("[")
        if name in alone(self.config.rootpath / file):
            return file + _ALONE
        if file.startswith(_SHARED):
            return _SHARED
        return f"{file}[{side}" if side and file.startswith(_BY_SIDE) else file

    def _assign_work_unit(self, node: Any) -> None:
        waiting = [unit for unit in self.workqueue if not unit.endswith(_ALONE)]
        front = node.gateway.id in (_FRONT if self.numnodes > 2 else {"gw0"})
        if not waiting:
            if len(self.assigned_work) > TOGETHER:
                return  # other processes are still busy; `remove_node` checks again
            waiting, front = sorted(self.workqueue, key=self._is_long), False  # the long ones first
        if not front and self.numnodes > 2 and node.gateway.id not in _LONG:
            waiting = [unit for unit in waiting if not self._is_long(unit)] or waiting
        unit = waiting[0 if front else -1]
        self.workqueue.move_to_end(unit, last=False)
        super()._assign_work_unit(node)

    def _is_long(self, unit: str) -> bool:
        file = self.config.rootpath / unit.partition("[")[0].removesuffix(_ALONE)
        return file.is_file() and has_long_tests(file)

    def _reschedule(self, node: Any) -> None:
        if self.workqueue and all(unit.endswith(_ALONE) for unit in self.workqueue) and not node.shutting_down:
            if sum(other is not node and not other.shutting_down for other in self.nodes) >= TOGETHER:
                node.shutdown()  # after its assigned work
                return
            if len(self.assigned_work) > TOGETHER:
                return
        super()._reschedule(node)

    def remove_node(self, node: Any) -> str | None:
        crashed = super().remove_node(node)
        for other in self.nodes:
            self._reschedule(other)
        return crashed

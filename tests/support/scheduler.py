"""Distributes test files to the processes of pytest-xdist; tests that need a whole core run last, two at a time."""

from __future__ import annotations

import os
from typing import Any

from xdist.scheduler import LoadFileScheduling

from tests.support.tiers import alone

_ALONE = "@alone"
"""Suffix for the separate work unit of a file's tests with this marker."""

_BY_SIDE = "tests/contract/"
"""Folder of long files with independent tests, split into one work unit per side, so that no process is last."""

TOGETHER = min(2, len(os.sched_getaffinity(0)))
"""Number of concurrent tests once only those with the marker `alone` are left, so that each has a core."""


class Scheduler(LoadFileScheduling):
    """Assigns files to the processes from both ends; the last busy processes continue with the `alone` tests.

    At most two processes receive files from the front, which start programs, because there are two cores.
    """

    def _split_scope(self, nodeid: str) -> str:
        file, _, test = nodeid.partition("::")
        name, _, side = test.partition("[")
        if name in alone(self.config.rootpath / file):
            return file + _ALONE
        return f"{file}[{side}" if side and file.startswith(_BY_SIDE) else file

    def _assign_work_unit(self, node: Any) -> None:
        waiting = [unit for unit in self.workqueue if not unit.endswith(_ALONE)]
        if not waiting:
            if len(self.assigned_work) > TOGETHER:
                return  # others are still busy; `remove_node` checks again
            waiting = list(self.workqueue)
        unit = waiting[0 if node.gateway.id in self._from_the_front() else -1]
        self.workqueue.move_to_end(unit, last=False)
        super()._assign_work_unit(node)

    def _from_the_front(self) -> set[str]:
        return {"gw0", "gw1"} if self.numnodes > 2 else {"gw0"}

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

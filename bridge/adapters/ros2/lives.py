"""Which participants' processes have ended, of those that run here: DDS itself notices a kill after 20 s.

A participant's GUID prefix has the low half of its process id; see `bridge.adapters.ros2.neighbours`. What cannot be
found here, or is another user's, is left to DDS.
"""

from __future__ import annotations

from pathlib import Path

from bridge.adapters.ros2.mark import is_marked
from bridge.adapters.ros2.neighbours import shares_memory, with_low_half

_HOST = slice(0, 4)
_PID = slice(4, 6)
_MOST = 1000


class Lives:
    """Remembers the processes of participants, and tells which are gone; for any thread.

    Args:
        own: our GUID prefix.
        proc: the process table.
    """

    def __init__(self, own: bytes, proc: Path = Path("/proc")) -> None:
        self._own, self._proc = own, proc
        self._processes: dict[bytes, dict[Path, str]] = {}

    def is_gone(self, prefix: bytes) -> bool:
        """Whether a participant's process was here when it was first asked for, and has ended since."""
        known = self._processes.get(prefix)
        if known is None:
            if len(self._processes) >= _MOST:
                self._processes.clear()
            known = self._processes[prefix] = self._find(prefix)
        return bool(known) and all(_start(process) != start for process, start in known.items())

    def _find(self, prefix: bytes) -> dict[Path, str]:
        if prefix[_HOST] != self._own[_HOST] or is_marked(prefix):
            return {}
        candidates = with_low_half(self._proc, int.from_bytes(prefix[_PID], "little"))
        found = {process: _start(process) for process in candidates if shares_memory(process)}
        return {process: start for process, start in found.items() if start}


def _start(process: Path) -> str:
    """When a process was started, "" where it has ended (proc(5): fields 3 and 22 of stat)."""
    try:
        fields = (process / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[19]

"""Files in the folder of POSIX shared memory: whose they are, and which no process uses any more.

Fast DDS 2.14 makes segments ``fastrtps_<hex>`` and ports ``fastrtps_port<n>``, each with a lock file ``<name>_el`` that
every living user holds locked (flock); zenoh 1.10 makes ``<number>.zenoh``. Both map their files while they use them.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_OURS = re.compile(r"fastrtps_[0-9a-z]+(_el)?|fast_datasharing_.*|sem\.fastrtps_port\d+_mutex|\S+\.zenoh")
_PORT = re.compile(r"fastrtps_port\d+(_el)?|sem\.fastrtps_.*")
_YOUNG_SECONDS = 10.0
"""A file so young may be just made, and not yet mapped."""


@dataclass(frozen=True, slots=True)
class SharedFile:
    """One file.

    Attributes:
        path: where it is.
        uid: its owner.
        size: its bytes in memory.
        held: whether a process maps it or has it open, None where that cannot be told.
        young: made just now.
    """

    path: Path
    uid: int
    size: int
    held: bool | None
    young: bool

    @property
    def fast_dds(self) -> bool:
        """Whether Fast DDS made it."""
        return not self.path.name.endswith(".zenoh")

    @property
    def port(self) -> bool:
        """Whether it is a port of Fast DDS's; a dead one is taken over when its number comes up again."""
        return _PORT.fullmatch(self.path.name) is not None


def shared_files(folder: Path, proc: Path) -> list[SharedFile]:
    """Files of Fast DDS and zenoh in a folder.

    Args:
        folder: ``/dev/shm``.
        proc: ``/proc``; where it cannot be read, nothing is known of who holds a file.
    """
    held, blind = _held(folder, proc)
    found: list[SharedFile] = []
    for path in sorted(_entries(folder)):
        with contextlib.suppress(OSError):
            stat = path.stat()
            # a process of another user may hold a file without our seeing it
            holding = True if str(path) in held else None if blind is None or stat.st_uid in blind else False
            young = time.time() - stat.st_mtime < _YOUNG_SECONDS
            found.append(SharedFile(path, stat.st_uid, stat.st_blocks * 512, holding, young))
    return found


def _entries(folder: Path) -> Iterator[Path]:
    with contextlib.suppress(OSError):
        yield from (path for path in folder.iterdir() if _OURS.fullmatch(path.name))


def _held(folder: Path, proc: Path) -> tuple[set[str], set[int] | None]:
    """Paths in the folder that processes map or have open, and the users whose processes could not be looked at."""
    held: set[str] = set()
    blind: set[int] = set()
    try:
        processes = [entry for entry in proc.iterdir() if entry.name.isdigit()]
    except OSError:
        return held, None
    prefix = f"{folder}/"
    for process in processes:
        uid = -1
        try:
            uid = process.stat().st_uid
            for line in (process / "maps").read_text(errors="replace").splitlines():
                _, found, name = line.partition(prefix)
                if found:
                    held.add(prefix + name.removesuffix(" (deleted)"))
            for descriptor in (process / "fd").iterdir():
                with contextlib.suppress(OSError):
                    target = str(descriptor.readlink())
                    if target.startswith(prefix):
                        held.add(target)
        except PermissionError:
            blind.add(uid)
        except OSError:
            continue  # it has ended meanwhile
    return held, blind

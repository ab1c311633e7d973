"""The store of one process: its file in the state folder, its synchronization over the hub, and its imports.

It is opened on first use.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bridge.config.model import Config
from bridge.config.sections.store import StoreSection
from bridge.hub import listeners, opening
from bridge.hub.errors import HubError
from bridge.hub.node import Hub
from bridge.state_file import worker_folder
from bridge.status import ModuleStatus
from bridge.stores.entry import StoreError, check_name
from bridge.stores.kinds import AREA, BEHAVIOR, CURRENT, LINK, LOCATION, MAP, MAP3D, OBJECT, PATH, Map3D, read_map3d
from bridge.stores.replica import Body, Key, Replica, StoreLimits
from bridge.stores.sharing import StoreSync
from bridge.stores.store import THE_MAP, Store, Write
from bridge.stores.wire import prefix
from bridge.worker import StatusHead
from yarp_compat.dev.extras import Extras, extras_file
from yarp_compat.dev.mapfile import MapFileError, read_text
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.places import Places, load_maps
from yarp_compat.sig.cloudfile import MAX_FILE

_log = logging.getLogger(__name__)


FORMS_3D = (".bt", ".ot", ".pcd", ".ply")
"""Files of three-dimensional maps: octomaps and point clouds."""


def read_files(path: Path, jail: Path | None = None) -> list[Write[Any]]:
    """Read a file with a map (``.map``, ROS's YAML), a collection of maps, places, or a three-dimensional map.

    Raises `StoreError`.

    With a ``jail`` the file may refer only to files in that folder.
    """
    try:
        if path.suffix.lower() in FORMS_3D:
            return [Write(MAP3D, path.stem, _map3d(path))]
        if path.suffix.lower() != ".ini":
            grid = MapGrid2D.load(path, jail)
            return [Write(MAP, grid.name or path.stem, grid)]
        if not read_text(path).lstrip().startswith("Version:"):
            return [Write(MAP, name, grid) for name, grid in load_maps(path, jail).items()]
        places, extras = Places.load(path, jail), extras_file(path)
        return places_writes(places, Extras.load(extras, jail) if extras.exists() else Extras())
    except MapFileError as err:
        raise StoreError(str(err)) from None


def _map3d(path: Path) -> Map3D:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE + 1)
        if len(data) <= MAX_FILE:
            return read_map3d(data)
    except OSError as err:
        raise StoreError(f"cannot read {path}: {err.strerror}") from None
    except StoreError as err:
        raise StoreError(f"{path}: {err}") from None
    raise StoreError(f"{path} has more than {MAX_FILE} bytes")


def places_writes(places: Places, extras: Extras) -> list[Write[Any]]:
    """Return the writes that store places and their extras."""
    by_kind: list[tuple[Any, dict[str, Any]]] = [
        (LOCATION, places.locations),
        (OBJECT, places.objects),
        (AREA, places.areas),
        (PATH, places.paths),
        (BEHAVIOR, extras.behaviors),
        (LINK, extras.links),
    ]
    return [Write(kind, name, value) for kind, values in by_kind for name, value in values.items()]


def import_at_start(store: Store, section: StoreSection) -> None:
    """Import the files named in the configuration; keys that the store has, or had and deleted, keep their state.

    Imported values count as older than any written value, so a machine that joins a deployment with its own files
    changes nothing there. A file that cannot be read is logged, and does not prevent the other imports.
    """
    for key, path in (("maps", section.maps), ("locations", section.locations)):
        if path is None:
            continue
        try:
            writes = read_files(path)
            if key == "maps" and writes and writes[0].kind is MAP:
                writes.append(Write(CURRENT, THE_MAP, writes[0].name))
            changes: dict[Key, Body | None] = {
                (write.kind.name, check_name(write.name)): write.kind.encode(write.name, write.value)
                for write in writes
                if not store.replica.remembers(write.kind.name, write.name)
            }
            imported = len(store.replica.write(changes, oldest=True))
        except StoreError as err:
            _log.error("store.%s: nothing imported: %s", key, err)
        else:
            _log.info("store.%s: imported %d of %d values from %s", key, imported, len(writes), path)


_WORKER = "store"


class StoreService:
    """Opens and closes the store. Safe to use from any thread.

    Args:
        config: the configuration.
        alone: name of the module whose separate process has its own replica; "" in the daemon's modules worker.
        join: creates a node on the hub, given the node's name and its name on the control plane.
    """

    def __init__(self, config: Config, alone: str, join: Callable[[str, str], Hub]) -> None:
        self._config, self._join = config, join
        self._name = f"{_WORKER}-{alone}" if alone else _WORKER
        self._lock = threading.Lock()
        self._open: tuple[Store, StoreSync, Hub] | None = None
        self._closed = False

    @property
    def store(self) -> Store:
        """The store, opened at first use; raises `StoreError` if it is disabled, or its file or the hub is unusable."""
        with self._lock:
            if self._open is None:
                if self._closed:
                    raise StoreError("the store is closed")
                if self._config.store.enabled is False:
                    raise StoreError("the store is disabled (store.enabled)")
                try:
                    self._open = self._open_store()
                except HubError as err:
                    raise StoreError(f"the store cannot join the hub: {err}") from err
            return self._open[0]

    def trouble(self) -> str:
        """Open the store if ``store.enabled`` is true; return why it cannot be opened, "" if it can or need not be."""
        if self._config.store.enabled is True:
            try:
                _ = self.store
            except StoreError as err:
                return str(err)
        return ""

    def import_again(self) -> None:
        """Import the configured files, whose contents have changed, as at the start; the store may not be open yet."""
        with self._lock:
            opened = self._open
        if opened is not None:
            import_at_start(opened[0], self._config.store)

    def close(self) -> None:
        """Close the store. Safe to call twice."""
        with self._lock:
            self._closed = True
            opened, self._open = self._open, None
        if opened is not None:
            store, share, hub = opened
            share.close()
            hub.close()
            store.replica.close()

    def _open_store(self) -> tuple[Store, StoreSync, Hub]:
        config = self._config
        section = config.store
        limits = StoreLimits(section.keys, section.megabytes << 20, section.deleted, section.deleted_days)
        replica = Replica(worker_folder(config) / f"{self._name}.sqlite", config.name, limits)
        with contextlib.ExitStack() as undo:
            undo.callback(replica.close)
            store = Store(replica)
            import_at_start(store, section)
            hub = self._join(f"midspan_{self._name.replace('-', '_')}", self._name)
            undo.callback(hub.close)
            share = StoreSync(replica, hub.keyspace(prefix(config.hub.domain)), hub.zid)
            undo.pop_all()
        hub.serve("status", lambda _params: self._status(store, share, hub))
        return store, share, hub

    def _status(self, store: Store, share: StoreSync, hub: Hub) -> dict[str, Any]:
        others = share.others()
        content = store.status().model_copy(update={"others": others, "refused": share.refused})
        counts = ", ".join(f"{count} {kind}{'' if count == 1 else 's'}" for kind, count in content.keys.items())
        shared = f"shared with {', '.join(others)}" if others else "not shared"
        names = {"daemon": self._config.name, "worker": self._name, "module": True}
        head = StatusHead(names, uptime=False, costs=False)
        return ModuleStatus(
            **head.fields("running", f"{counts or 'empty'}; {shared}", refused=[], store=content),
            zid=hub.zid,
            routes=[],
            warnings=[text for text in (opening.trouble(), listeners.trouble()) if text],
        ).document()

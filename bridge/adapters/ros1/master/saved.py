"""The master's state file: registrations and parameters, so that a restart of the master loses neither."""

from __future__ import annotations

import base64
import contextlib
import json
import logging
import threading
import time
import xmlrpc.client
from pathlib import Path
from typing import Any

from bridge.adapters.ros1.master.api import MasterApi
from bridge.adapters.ros1.master.parameters import ParameterTree
from bridge.adapters.ros1.master.registrations import Kind, Registrations
from bridge.state_file import keep

_log = logging.getLogger("midspan.ros1.master")

_VERSION = 1
_PAUSE = 0.1
_FAILED_PAUSE = 30.0
_SHARE = 20
"""The pause before the next write is at least this many times as long as the last write took."""

_JOIN_SECONDS = 2.0
_BINARY, _TIME = "\0binary", "\0time"
"""Keys that no parameter can have, because XML has no such character."""


def load(file: Path, api: MasterApi) -> bool:
    """Restore a master's state; return whether a valid file existed. An invalid file is reported and renamed."""
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as err:
        _log.warning("cannot read %s: %s; this master starts without its previous state", file, err)
        return False
    try:
        document = json.loads(text, object_hook=_decode)
        registrations, parameters = Registrations(), ParameterTree()
        if document["version"] != _VERSION:
            raise ValueError(f"format {document['version']} is not known to this version of Midspan")  # noqa: TRY301
        parameters.set("/", document["parameters"])
        for kind, key, node, address, service_api in document["registrations"]:
            registrations.register(Kind[kind], *map(str, (key, node, address, service_api)))
        registrations.types.update({str(topic): str(kind) for topic, kind in document["types"].items()})
        for node in registrations.nodes.keys() & set(document.get("reachable", registrations.nodes)):
            registrations.nodes[node].reachable = True
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as err:
        spare = file.with_name(f"{file.name}.invalid")
        with contextlib.suppress(OSError):
            file.replace(spare)
        _log.warning(
            "invalid state file: %s; this master starts without its previous state, and the file becomes %s", err, spare
        )
        return False
    with api.lock:
        api.registrations, api.parameters = registrations, parameters
    return True


def dump(api: MasterApi) -> str:
    """Return a master's state as text."""
    with api.lock:
        parameters, types = api.parameters.values, dict(api.registrations.types)
        links = [(kind.name, key, *link, service_api) for kind, key, link, service_api in api.registrations]
        reachable = [name for name, node in api.registrations.nodes.items() if node.reachable]
    document = {
        "version": _VERSION, "registrations": links, "types": types, "reachable": reachable, "parameters": parameters,
    }  # fmt: skip
    return json.dumps(document, default=_encode)


def _encode(value: object) -> dict[str, str]:
    if isinstance(value, xmlrpc.client.Binary):
        return {_BINARY: base64.b64encode(value.data).decode()}
    assert isinstance(value, xmlrpc.client.DateTime)
    return {_TIME: str(value)}


def _decode(value: dict[str, Any]) -> object:
    if _BINARY in value:
        return xmlrpc.client.Binary(base64.b64decode(value[_BINARY]))
    return xmlrpc.client.DateTime(value[_TIME]) if _TIME in value else value


class StateWriter:
    """Writes the state file after changes, on its own thread."""

    def __init__(self, file: Path, api: MasterApi) -> None:
        self._file, self._api = file, api
        self._dirty = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-ros1-state", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def changed(self) -> None:
        """Write the file soon."""
        self._dirty.set()

    def close(self) -> None:
        """Write the last changes."""
        self._stopping.set()
        self._dirty.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_SECONDS)

    def _run(self) -> None:
        pause, last = _PAUSE, False
        while not last:
            self._dirty.wait()
            last = self._stopping.wait(pause)
            self._dirty.clear()
            started = time.monotonic()
            if keep(self._file, dump(self._api), "a restart of this master will lose its current state"):
                pause = max(_PAUSE, _SHARE * (time.monotonic() - started))
            else:
                pause = _FAILED_PAUSE
                self._dirty.set()

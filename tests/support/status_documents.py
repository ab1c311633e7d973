"""Real status documents: those of all workers and of the daemon, recorded before the documents were typed.

A new release may add keys, but must keep the recorded ones.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bridge.status import read_status

_RECORDED = json.loads((Path(__file__).parent / "status_documents.json").read_text())

DOCUMENTS: dict[str, dict[str, Any]] = _RECORDED["workers"]
"""The recorded documents, by worker."""

DAEMON: dict[str, Any] = _RECORDED["daemon"]

_OF_ALL_MODULES = set[str].intersection(*(set(each) for each in DOCUMENTS.values() if "module" in each))
"""Keys of each module; a module's own keys depend on its settings and state."""

_NEED_A_DESCRIPTOR = {"cpu", "rss"}
"""Keys that a process without a free file descriptor leaves out."""


def check_document(document: dict[str, Any], worker: str) -> None:
    """Assert that a running worker's document has the recorded keys, and is unchanged after being parsed."""
    status = read_status(document, document.get("daemon", "d"), worker)
    assert status.document() == {"daemon": status.daemon, "worker": worker, **document}
    recorded = DOCUMENTS[worker].keys() & (_OF_ALL_MODULES if "module" in document else DOCUMENTS[worker].keys())
    assert recorded - document.keys() <= _NEED_A_DESCRIPTOR
    kinds = {route["kind"]: route for recorded in DOCUMENTS.values() for route in recorded.get("routes", ())}
    for route in document.get("routes", ()):
        assert not kinds[route["kind"]].keys() - route.keys()

"""Message types: unknown ones, ones that cannot be built, and definitions that differ."""

from __future__ import annotations

from collections.abc import Sequence

from bridge.adapters.ros2.environment import available
from bridge.doctor.around import Around, Document
from bridge.doctor.finding import Finding, fail, ok, skip, warn
from bridge.doctor.hubtypes import CURE, conflicts
from bridge.interfaces.compiler import Compiler
from bridge.interfaces.errors import BuildError

_SHOWN = 20
_DIFFERS = ("differ", "RIHS01", "md5", "fingerprint")


def look_at_refused(around: Around) -> Sequence[Finding]:
    """What the workers refused, but for definitions that differ."""
    if not around.hub.documents:
        return [skip("no worker answers")]
    return _refusals(around, differing=False) or [ok("every type could be used")]


def look_at_hashes(around: Around) -> Sequence[Finding]:
    """What the workers refused because definitions differ, and the same among the hub's endpoints."""
    if around.hub.error:
        return [skip("the hub does not answer")]
    findings = _refusals(around, differing=True)
    findings += [warn(text, CURE) for text in _warnings(around) if "md5" in text][:_SHOWN]
    findings += [fail(conflict.text, conflict.cure) for conflict in conflicts(around.hub.endpoints)][:_SHOWN]
    return findings or [ok("no definition differs")]


def look_at_compiler(around: Around) -> Sequence[Finding]:
    """Could `midspan interfaces build` make a ROS 2 message package that a program here lacks?"""
    if around.config.ros2.enabled is False or available(around.config):
        return [skip("no ROS 2 here")]
    try:
        compiler = Compiler.find()
    except BuildError as err:
        return [warn(f"{err}: message packages that are missing cannot be built", err.cure)]
    return [ok(f"{compiler.cpp}")]


def _refusals(around: Around, *, differing: bool) -> list[Finding]:
    found: list[Finding] = []
    for document in around.hub.documents:
        refused = document.get("refused")
        for entry in refused if isinstance(refused, list) else ():
            reason = str(entry.get("reason", ""))
            if any(word in reason for word in _DIFFERS) is differing:
                found.append(_refusal(document, entry, reason))
    more = len(found) - _SHOWN
    return found[:_SHOWN] + ([fail(f"and {more} more", "'midspan status' shows all")] if more > 0 else [])


def _warnings(around: Around) -> list[str]:
    found = (document.get("warnings") for document in around.hub.documents)
    return [str(text) for texts in found if isinstance(texts, list) for text in texts]


def _refusal(document: Document, entry: Document, reason: str) -> Finding:
    way = f"{document.get('side')} -> hub" if entry.get("direction") == "in" else f"hub -> {document.get('side')}"
    return fail(f"{entry.get('topic')} ({entry.get('type')}, {way}): {reason}", str(entry.get("cure", "")))

"""Message types that are unknown or cannot be built, and definitions that differ."""

from __future__ import annotations

from bridge.adapters.ros2.environment import available
from bridge.descriptors import all_modules
from bridge.doctor.check import Finding, Findings, fail, merged, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.doctor.hub_problems import CURE, conflicts, separated
from bridge.doctor.relayed import relay_texts, relayed_keys
from bridge.interfaces.compiler import Compiler
from bridge.interfaces.definition import BuildError
from bridge.messages.registry import Registry
from bridge.registration import imported
from bridge.status import RefusedRoute, StatusDocument, refused_routes

_SHOWN = 20
_DIFFERS = ("differ", "RIHS01", "md5", "fingerprint")


def check_refused(context: CheckContext) -> Findings:
    """Report what the workers refused, except for definitions that differ."""
    if context.hub.error or not context.hub.documents:
        return skip("no worker answers")
    return [*(_refusals(context, differing=False) or [ok("no type was refused")]), *_accepted(context)]


def check_hashes(context: CheckContext) -> Findings:
    """Report definitions that differ: refused by the workers, or between the hub's endpoints."""
    if context.hub.error:
        return skip("the hub does not answer")
    findings = _refusals(context, differing=True)
    findings += merged([warn(text, CURE) for text in _warnings(context) if "md5" in text])[:_SHOWN]
    documents = context.hub.documents
    workers = {zid for document in documents for zid in document.hub_sessions}
    relayed = relayed_keys(documents)
    notes = conflicts(context.hub.endpoints, workers, lambda: Registry.of(context.config.types).releases, relayed)
    findings += merged([fail(note.text, note.cure) for note in notes])[:_SHOWN]
    separate = separated(context.hub.endpoints, workers, relayed)
    findings += merged([warn(note.text, note.cure) for note in separate])[:_SHOWN]
    findings += [ok(text) for text in relay_texts(documents)[:_SHOWN]]
    return findings or ok("no definitions differ")


def check_compiler(context: CheckContext) -> Findings:
    """Check that `midspan interfaces build` could build a ROS 2 message package that a program here lacks."""
    if context.config.ros2.enabled is False or available(context.config):
        return skip("no ROS 2 here")
    try:
        compiler = Compiler.find()
    except BuildError as err:
        return warn(f"{err}: missing message packages cannot be built", err.cure)
    return ok(f"{compiler.cpp}")


def _refusals(context: CheckContext, *, differing: bool) -> list[Finding]:
    findings: list[Finding] = []
    for document in context.hub.documents:
        for route in refused_routes(document):
            differs = any(phrase in route.reason for phrase in _DIFFERS)
            if differs is differing and not _accepts(context, document, route):
                findings.append(_refusal(document, route))
    findings = merged(findings)
    more = len(findings) - _SHOWN
    return findings[:_SHOWN] + ([fail(f"and {more} more", "'midspan status' shows all")] if more > 0 else [])


def _accepted(context: CheckContext) -> list[Finding]:
    """Return findings on refused routes that modules accept."""
    topics: dict[str, set[str]] = {}
    for document in context.hub.documents:
        for route in refused_routes(document):
            if why := _accepts(context, document, route):
                topics.setdefault(why, set()).add(route.topic)
    return [ok(f"{', '.join(sorted(names))}: {why}") for why, names in sorted(topics.items())]


def _accepts(context: CheckContext, document: StatusDocument, route: RefusedRoute) -> str:
    """Return why a module accepts that a side refused a route, "" if no module does."""
    functions = (imported(module.accepts) for module in all_modules().values() if module.accepts)
    return next(filter(None, (accepts(context, document, route) for accepts in functions)), "")


def _warnings(context: CheckContext) -> list[str]:
    return [text for document in context.hub.documents for text in document.warnings]


def _refusal(document: StatusDocument, route: RefusedRoute) -> Finding:
    direction = f"{document.side} -> hub" if route.direction == "in" else f"hub -> {document.side}"
    return fail(f"{route.topic} ({route.type}, {direction}): {route.reason}", route.cure)

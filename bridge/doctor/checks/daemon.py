"""The configuration, and the daemons with their workers."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from itertools import combinations, product

from bridge.config.document import ConfigError
from bridge.config.listeners import listeners
from bridge.config.load import load
from bridge.config.model import Config
from bridge.daemon.query import Phase
from bridge.daemon.units import STATE, log_hint, start_hint, units_in_use
from bridge.descriptors import all_modules
from bridge.doctor.causes import cause, grouped, shared
from bridge.doctor.check import Finding, Findings, fail, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.doctor.daemon_state import RELOAD_CURE, restarted
from bridge.doctor.hub_problems import Note
from bridge.hub import WORKER as ROUTER
from bridge.registration import imported
from bridge.state_file import named
from bridge.status import ModuleStatus, StatusDocument

_HUB = "hub.listen"
_COMES = {phase.value for phase in (Phase.QUEUED, Phase.STARTING, Phase.PAUSED)}
"""The states that the daemon reports for a worker that does not answer on the hub yet."""


def check_config(context: CheckContext) -> Findings:
    """Report the file's problems, a refused reload, and a hub that is open to other machines without TLS."""
    state = context.daemon
    findings = [warn(f"the daemon {state.name}: {state.refusal}", RELOAD_CURE)] if state.refusal else []
    if not context.config_good:
        problems = context.config_text.splitlines()
        return [*[fail(line, "correct it ('midspan config check')") for line in problems], *findings]
    findings.insert(0, ok(context.config_text))
    listener = context.config.hub.open
    if listener.insecure:
        endpoints = ", ".join((*listener.listen, *listener.connect))
        seen = f"the hub is open without TLS at {endpoints}: any machine that reaches it can join"
        findings.append(warn(seen, "make certificates ('midspan keys'), and write tls/ endpoints in hub.open"))
    return findings


def check_services(context: CheckContext) -> Findings:
    """Check the daemons that run as services here: their configurations, and resources that two cannot share."""
    units = units_in_use(context.root)
    if len(units) < 2:
        return skip("fewer than two daemons run as services here")
    findings: list[Finding] = []
    configs: dict[str, Config] = {}
    for unit, file in units.items():
        try:
            config = named(load(file), {"STATE_DIRECTORY": str(context.root / STATE.relative_to("/"))})
        except ConfigError as err:
            findings += [fail(f"{unit}: {line}", f"midspan config check {file}") for line in str(err).splitlines()]
            continue
        findings.append(ok(f"{unit} is the daemon {config.name} ({file})"))
        configs[unit] = config
    return [*findings, *_shared_settings(configs), *_shared_ports(configs)]


def _shared_settings(configs: Mapping[str, Config]) -> Iterator[Finding]:
    """Yield a finding for each name and address that several daemons have, except the address of a shared hub."""
    claims: dict[tuple[str, str], list[str]] = {}
    for unit, config in configs.items():
        addresses = [
            (listener.key, listener.text) for listener in listeners(config) if listener.port and listener.key != _HUB
        ]
        for claim in dict.fromkeys([("name", config.name), *addresses]):
            claims.setdefault(claim, []).append(unit)
    for (key, value), owners in claims.items():
        if len(owners) > 1:
            seen = f"{' and '.join(owners)} have the same {key}: {value}"
            yield fail(seen, f"give each of them its own {key}")


def _shared_ports(configs: Mapping[str, Config]) -> Iterator[Finding]:
    """Yield a finding for each pair of addresses of two daemons that share a port.

    This leaves out pairs that `_shared_settings` reports, and pairs of ``hub.listen``, because daemons may share a hub.
    """
    for (first_unit, first), (other, second) in combinations(configs.items(), 2):
        for listener, taken in product(listeners(second), listeners(first)):
            alike = listener.key == taken.key and (listener.text == taken.text or listener.key == _HUB)
            if listener.excludes(taken) and not alike:
                seen = (
                    f"{listener.key} of {other} ({listener.text}) uses the same port as {taken.key} of {first_unit}"
                    f" ({taken.text})"
                )
                yield fail(seen, "change one of the ports")


def check_workers(context: CheckContext) -> Findings:
    """Check the daemon itself, and the state of each worker."""
    hub, state = context.hub, context.daemon
    missing = [fail(state.trouble, state.cure)] if state.trouble else []
    if hub.error:
        absent = [_worker(context, document) for document in hub.documents]
        cure = "" if absent or missing else start_hint(state.unit)
        return [*missing, warn(hub.error.splitlines()[0], cure), *absent]
    if not hub.documents:
        listen, domain = context.config.hub.listen, context.config.hub.domain
        seen = f"a router answers at {listen}, but no worker does in domain {domain}"
        return [*missing, warn(seen, "start the daemon: midspan run; if it runs, compare its hub.domain")]
    findings = list(missing)
    for daemon in dict.fromkeys(document.daemon for document in hub.documents):
        workers = [document for document in hub.documents if document.daemon == daemon]
        common = shared({document.worker: document.warnings for document in workers})
        findings += _alone(context, daemon, workers)
        findings += [_worker(context, document, common) for document in workers]
        for text, names in common.values():
            findings.append(warn(f"{', '.join(f'{daemon}/{name}' for name in names)}: {text}"))
    return findings


def _alone(context: CheckContext, daemon: str, workers: Sequence[StatusDocument]) -> list[Finding]:
    """Return a warning if only the router of a daemon of another name answers: a router outlives its daemon."""
    if daemon == context.config.name or [document.worker for document in workers] != [ROUTER.name]:
        return []
    seen = f"only the router of {daemon} answers: the daemon is down, or runs no other worker"
    return [warn(seen, f"run 'midspan status' on its machine; {start_hint('midspan')}")]


def _worker(context: CheckContext, document: StatusDocument, elsewhere: Container[str] = ()) -> Finding:
    """Return a finding on a worker's state, without the warnings whose causes are in ``elsewhere``."""
    name = f"{document.daemon}/{document.worker}"
    state, log = document.state, log_hint(context.daemon.unit)
    if document.error:
        return fail(f"{name} {'does not answer' if state == 'failed' else f'is {state}'}: {document.error}", log)
    if document.loops:
        return fail(f"{name} crashes again and again; it is now {state}: {document.text}", log)
    crashes = restarted(document.restarts, document.ended) if document.ended else ""
    again = f" ({crashes})" if crashes else ""
    warnings = [text for text in document.warnings if cause(text) not in elsewhere]
    if warnings:
        note = _cause(context, document)
        cure = note.cure if note is not None and any(note.text in warning for warning in warnings) else ""
        return warn(f"{name} is {state}{again}, and warns: {'; '.join(grouped(warnings))}", cure)
    if state == "waiting":
        return _waiting(context, document, name)
    if state in ("running", "standby"):
        return ok(f"{name} is {state}{again}")
    if state == Phase.FAILED.value:
        return fail(f"{name} {state}: {document.text}", log)
    if state in _COMES:
        crashed = state == Phase.PAUSED.value or document.restarts
        return warn(f"{name} is {state}: {document.text}", log if crashed else "wait")
    return skip(f"{name} reports {state}")


def _waiting(context: CheckContext, document: StatusDocument, name: str) -> Finding:
    """Return a finding on a waiting worker: a side waits for its network, and a module reports what it waits for."""
    if not isinstance(document, ModuleStatus):
        # the warning of several workers, which is a separate finding, may be the reason
        cure = "" if document.warnings else "see the checks of that side"
        return warn(f"{name} waits: its network is unavailable", cure)
    note = _cause(context, document)
    return warn(f"{name} waits: {document.text if note is None else note.text}", "" if note is None else note.cure)


def _cause(context: CheckContext, document: StatusDocument) -> Note | None:
    """Return why a module waits or warns, if its descriptor names a function that finds that out."""
    module = all_modules().get(document.worker)
    note: Note | None = imported(module.cause)(context, document) if module is not None and module.cause else None
    return note

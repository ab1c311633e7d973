"""This machine: its limits, its clock compared with those of other machines, and the libraries available for it."""

from __future__ import annotations

import importlib.metadata
import math
import sys
from collections.abc import Mapping, Sequence

import psutil
from packaging.markers import default_environment
from packaging.requirements import Requirement

from bridge import kernels, state_file
from bridge.clock import CLOCK_TOPIC
from bridge.daemon.workers import worker_kinds
from bridge.doctor.check import Finding, Findings, fail, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.hub.graph.tokens import EndpointKind
from bridge.resources import FULL, RAISE, folder_trouble
from bridge.status import StatusDocument

WANTED = 4096
"""Descriptors: one for each connection of a thousand topics with several connections each, and some spare ones."""


def check_descriptors(context: CheckContext) -> Findings:
    """Check this shell's limit, which a daemon started here would get, and how close the workers are to theirs."""
    if sys.platform == "win32":
        return skip("Windows has no such limit")
    import resource

    _soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    findings: list[Finding] = []
    if hard != resource.RLIM_INFINITY and hard < WANTED:
        findings.append(_low(f"at most {hard} files can be open at once"))
    workers = [
        StatusDocument(daemon=context.daemon.name, worker=worker.worker, pid=worker.pid)
        for worker in context.daemon.document.workers
    ]
    lowest: dict[str, float] = {}  # by daemon, whose workers inherit its limit
    for document in context.hub.documents or workers:  # without descriptors the router lets no program join
        process = context.process(document)
        if process is not None:
            used, limit = _open_files(process)
            if used > FULL * limit:
                findings.append(
                    fail(f"{document.daemon}/{document.worker} has {used} files open of {limit} allowed", RAISE)
                )
            lowest[document.daemon] = min(limit, lowest.get(document.daemon, limit))
    findings += [
        _low(f"each process of {daemon} can open at most {limit} files")
        for daemon, limit in lowest.items()
        if limit < WANTED
    ]
    return findings or ok(f"{'no limit' if hard == resource.RLIM_INFINITY else hard}")


def _low(limit: str) -> Finding:
    return warn(f"{limit}; 1,000 topics need {WANTED}", RAISE)


def _open_files(process: psutil.Process) -> tuple[int, float]:
    """Return how many files a process has open, and its limit; (0, infinity) if unknown."""
    try:
        used, (soft, _hard) = process.num_fds(), process.rlimit(psutil.RLIMIT_NOFILE)
    except (psutil.Error, AttributeError):  # another user's process, or not Linux
        return 0, math.inf
    return used, soft if soft > 0 else math.inf


def check_state(context: CheckContext) -> Findings:
    """Check that the daemon can store its state."""
    folder = state_file.state_folder(context.config, context.environ)
    if not folder.exists():
        return skip(f"{folder} does not exist yet; the daemon creates it")
    seen, _, cure = folder_trouble(folder).rpartition("; ")
    return fail(seen, cure) if seen else ok(str(folder))


def check_kernels(_around: CheckContext) -> Findings:
    """Check that the kernels are compiled, and from the current sources."""
    state = kernels.state()
    if state.missing:
        refused = ", and RobotGoto and RobotPathPlanner refuse goals"
        drives = not set(state.missing) & set(kernels.DRIVING)
        return fail(f"{state}; parts that use them are slow or missing{'' if drives else refused}", kernels.CURE)
    return warn(str(state), kernels.REBUILD) if state.stale else ok(str(state))


WARN_SECONDS = 0.02
"""Clock difference in seconds above which there is a warning: transforms of a moving robot are usually looked up within
some tens of milliseconds."""
FAIL_SECONDS = 0.5
_CURE_CLOCK = "synchronize them: apt install chrony on both machines, and let one of them serve the time to the other"


_CURE_TIME = "start the simulation or 'midspan play --clock', or set clock.source: system"


def check_clocks(context: CheckContext) -> Findings:
    """Return a finding for each daemon whose clock differs, and one if simulated time has no publisher."""
    findings = _simulated_time(context)
    if not context.hub.clocks:
        return findings or skip("no worker reports its time")
    daemons: dict[str, tuple[float, float]] = {}
    for name, offset in context.hub.clocks.items():
        daemon = name.partition("/")[0]
        if daemon not in daemons or offset.error < daemons[daemon][1]:
            daemons[daemon] = (offset.seconds, offset.error)
    for daemon, (seconds, error) in sorted(daemons.items()):
        sure = max(abs(seconds) - error, 0.0)
        relation = "ahead of" if seconds > 0 else "behind"
        text = (
            f"{daemon}'s clock is {abs(seconds) * 1e3:.1f} ms {relation} this machine's (within {error * 1e3:.1f} ms)"
        )
        if sure > FAIL_SECONDS:
            findings.append(fail(text, _CURE_CLOCK))
        elif sure > WARN_SECONDS:
            findings.append(warn(text, _CURE_CLOCK))
    return findings or ok(f"the clocks of {', '.join(sorted(daemons))} agree with this machine's")


def _simulated_time(context: CheckContext) -> list[Finding]:
    hub = context.hub
    published = any(end.topic == CLOCK_TOPIC and end.kind is EndpointKind.PUBLISHER for end in hub.endpoints)
    if not context.config.clock.simulated or not hub.documents or published:
        return []
    seen = f"clock.source is sim, but {CLOCK_TOPIC} has no publisher: programs on simulated time wait in sleep"
    return [fail(seen, _CURE_TIME)]


def check_wheels(context: CheckContext) -> Findings:
    """Check that binary wheels exist for this system, or that the side's packages are installed in another way."""
    try:
        requirements = importlib.metadata.requires("midspan") or []
    except importlib.metadata.PackageNotFoundError:
        return skip("Midspan is not installed as a package: run make setup, or pip install")
    environment = {name: str(value) for name, value in default_environment().items()}
    return compare(context, requirements, environment)


def compare(context: CheckContext, requirements: Sequence[str], environment: Mapping[str, str]) -> Findings:
    """Return findings on the requirements that a system leaves out; an extra has the name of the side that needs it."""
    system = f"{environment['sys_platform']}, {environment['platform_machine']}"
    kinds = worker_kinds()
    findings: list[Finding] = []
    for side, names in left_out(requirements, environment).items():
        kind = kinds.get(side)
        if kind is None or kind.enabled(context.config) is False:
            continue
        seen = f"no wheel on this system ({system}): {', '.join(names)}"
        if not kind.missing(context.config):
            findings.append(ok(f"{seen}; side {side} uses what is installed"))
            continue
        report = fail if kind.enabled(context.config) is True else warn
        cure = f"run 'midspan worker {side}' on a machine of this hub that has them; here, set {side}.enabled: false"
        findings.append(report(f"{seen}; so side {side} is not available", cure))
    return findings or ok(f"all dependencies have wheels for this system ({system})")


def left_out(requirements: Sequence[str], environment: Mapping[str, str]) -> dict[str, list[str]]:
    """Return for each extra the names of the requirements that their markers leave out on a system."""
    missing: dict[str, list[str]] = {}
    for requirement in map(Requirement, requirements):
        marker = requirement.marker
        extra = extra_of(str(marker)) if marker is not None else ""
        if marker is not None and not marker.evaluate({**environment, "extra": extra}):
            missing.setdefault(extra, []).append(requirement.name)
    return missing


def extra_of(marker: str) -> str:
    """Return the extra to which a requirement in a package's metadata belongs, "" for none."""
    _, _, condition = marker.partition('extra == "')
    return condition.partition('"')[0]

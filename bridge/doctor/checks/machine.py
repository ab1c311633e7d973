"""Limits of this machine."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import psutil

from bridge.config import state
from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, skip, warn
from bridge.routing.room import FULL, RAISE

WANTED = 4096
"""rospy takes about two descriptors for a subscribed topic; a thousand topics and room for the rest."""


def look_at_descriptors(around: Around) -> Sequence[Finding]:
    """This shell's limit, which a daemon started here would get, and how much of theirs the workers use."""
    if sys.platform == "win32":
        return [skip("Windows has no such limit")]
    import resource

    _soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    findings: list[Finding] = []
    if hard != resource.RLIM_INFINITY and hard < WANTED:
        findings.append(warn(f"at most {hard} files may be open at once; 1,000 topics want {WANTED}", RAISE))
    for document in around.hub.documents:
        process = around.process(document)
        if process is not None:
            findings += _worker(f"{document.get('daemon')}/{document.get('worker')}", process)
    return findings or [ok(f"{'no limit' if hard == resource.RLIM_INFINITY else hard}")]


def _worker(name: str, process: psutil.Process) -> list[Finding]:
    try:
        used, (soft, _hard) = process.num_fds(), process.rlimit(psutil.RLIMIT_NOFILE)
    except (psutil.Error, AttributeError):  # another user's, or no Linux
        return []
    if soft > 0 and used > FULL * soft:
        return [fail(f"{name} has {used} files open of {soft} allowed", RAISE)]
    return []


def look_at_state(around: Around) -> Sequence[Finding]:
    """Whether the daemon can keep what it must know again."""
    folder = state.state_folder(around.config, around.environ)
    if not folder.exists():
        return [skip(f"{folder} is not there yet; the daemon makes it")]
    seen, _, cure = state.trouble(folder).rpartition("; ")
    return [fail(seen, cure)] if seen else [ok(str(folder))]

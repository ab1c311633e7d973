"""Shortens a failing input while it fails in the same manner; each attempt runs in a separate process."""

from __future__ import annotations

import os
import resource
import select
import signal
import time

from tests.fuzz.run import finding_of, limit_memory, warm
from tests.fuzz.target import Subject

_TRIES = 400
_SECONDS = 30.0
_PROCESSOR_SECONDS = 4


def shrunk(subject: Subject, content: bytes) -> tuple[str, bytes]:
    """Return how an input fails ("" if it does not), and the shortest input found with the same failure."""
    warm(subject)
    signature = probe(subject, content)
    if not signature:
        return "", content
    end = time.monotonic() + _SECONDS
    tries = _TRIES
    size = max(len(content) // 2, 1)
    while size and tries > 0 and time.monotonic() < end:
        at = 0
        while at < len(content) and tries > 0 and time.monotonic() < end:
            shorter = content[:at] + content[at + size :]
            tries -= 1
            if probe(subject, shorter) == signature:
                content = shorter
            else:
                at += size
        size //= 2
    return signature, content


def probe(subject: Subject, content: bytes) -> str:
    """Return how an input fails: an exception and its place, a signal, or ``hang``; "" if it does not fail."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _try(subject, content, writing)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        if not select.select([pipe], [], [], 10.0)[0]:
            os.kill(child, signal.SIGKILL)
        failure = pipe.read().decode(errors="replace")
    _, status = os.waitpid(child, 0)
    number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    if number in (signal.SIGXCPU, signal.SIGKILL):
        return "hang"
    return f"signal {number}" if number else failure


def _try(subject: Subject, content: bytes, writing: int) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (_PROCESSOR_SECONDS, _PROCESSOR_SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        limit_memory()
        subject.parse(content)
    except subject.refuses:
        pass
    except BaseException as err:
        os.write(writing, finding_of(err, content).signature.encode())
    finally:
        os._exit(0)

"""Supervises the fuzzing processes: detects crashes and hangs, and the input that caused them."""

from __future__ import annotations

import base64
import contextlib
import json
import math
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from tests.fuzz.run import JOURNAL, JOURNAL_IDLE, STACKS, TRACE_CHARACTERS, Finding, Journal
from tests.fuzz.target import Target

_HANG_SECONDS = 4.0
"""Processor time after which an input counts as a hang, seconds."""

_STUCK_SECONDS = 60.0
"""Real time after which an input counts as a hang, seconds, if it waits instead of using the processor."""

_STACKS_SECONDS = 2.0
_PIECE = 150_000
_MOST_DEATHS = 5
_PROGRAM = ("-m", "tests.fuzz.child")


@dataclass
class Outcome:
    """The result of one target."""

    inputs: int = 0
    seconds: float = 0.0
    findings: dict[str, Finding] = field(default_factory=dict)


class _DeadError(Exception):
    """The process exited, or was killed, during an input; ``stacks`` are the stacks of its threads at that time."""

    def __init__(self, how: str, number: int, content: bytes, stacks: str) -> None:
        super().__init__(how)
        self.how, self.number, self.content, self.stacks = how, number, content, stacks


class _Worker:
    """One fuzzing process."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="midspan-fuzz-")
        path = Path(self._folder.name) / "journal"
        path.write_bytes(bytes(JOURNAL))
        self._journal = Journal(path)
        self._journal.write(JOURNAL_IDLE, b"")  # idle until the first input, because the process may take long to start
        self._stacks = path.with_name(STACKS)
        self._process = subprocess.Popen(
            [sys.executable, "-W", "ignore", *_PROGRAM, str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=Path(__file__).parents[2],
            env={**os.environ, "PYTHONHASHSEED": "0", "MALLOC_ARENA_MAX": "1", "TMPDIR": self._folder.name},
        )

    def ask(self, work: dict[str, Any]) -> dict[str, Any]:
        """Run a job; raises `_DeadError` if the process dies."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(work).encode() + b"\n")
            self._process.stdin.flush()
        last, since, spent = JOURNAL_IDLE, time.monotonic(), self._spent()
        while not select.select([self._process.stdout], [], [], 0.25)[0]:
            number, content = self._journal.read()
            if number != last or number == JOURNAL_IDLE:
                last, since, spent = number, time.monotonic(), self._spent()
            elif self._spent() - spent > _HANG_SECONDS or time.monotonic() - since > _STUCK_SECONDS:
                stacks = self._stop_with_stacks()
                self.close()
                raise _DeadError("hang", number, content, stacks)
        line = self._process.stdout.readline()
        if not line:
            number, content = self._journal.read()
            code = self._process.wait()
            stacks = self._read_stacks()
            self.close()
            raise _DeadError(f"signal {-code}" if code < 0 else f"exit code {code}", number, content, stacks)
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _stop_with_stacks(self) -> str:
        """Have the process write the stacks of its threads and exit, and return them."""
        self._process.send_signal(signal.SIGABRT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_STACKS_SECONDS)
        return self._read_stacks()

    def _read_stacks(self) -> str:
        return self._stacks.read_text(errors="replace")[:TRACE_CHARACTERS] if self._stacks.is_file() else ""

    def _spent(self) -> float:
        try:
            times = psutil.Process(self._process.pid).cpu_times()
        except psutil.Error:
            return 0.0
        return times.user + times.system

    def close(self) -> None:
        """Stop the process."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        self._folder.cleanup()


class Fuzzing:
    """Fuzzes targets in several processes, and collects the results.

    Args:
        targets: the targets with their number of inputs.
        seed: of the random generator.
        jobs: number of processes.
        limit: seconds of processor time per target; a slow target runs fewer inputs.
    """

    def __init__(self, targets: dict[Target, int], seed: int, jobs: int, limit: float = math.inf) -> None:
        self.outcomes = {target.name: Outcome() for target in targets}
        self._limits = {target.name: limit / max(inputs, 1) for target, inputs in targets.items()}
        self._seed, self._jobs = seed, jobs
        self._lock = threading.Lock()
        pieces = [(t.name, k, min(_PIECE, n - k)) for t, n in targets.items() for k in range(0, n, _PIECE)]
        self._work = deque(sorted(pieces, key=lambda piece: -piece[2]))

    def run(self) -> None:
        """Run all targets."""
        threads = [threading.Thread(target=self._job, name=f"fuzz-{n}") for n in range(self._jobs)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _next(self) -> tuple[str, int, int] | None:
        with self._lock:
            return self._work.popleft() if self._work else None

    def _job(self) -> None:
        worker = _Worker()
        try:
            while (piece := self._next()) is not None:
                worker = self._fuzz(worker, *piece)
        finally:
            worker.close()

    def _fuzz(self, worker: _Worker, name: str, begin: int, inputs: int) -> _Worker:
        outcome = self.outcomes[name]
        findings: list[Finding] = []
        done = 0
        for life in range(_MOST_DEATHS):
            seed = f"{name} {self._seed} {begin}" + (f" {life}" if life else "")
            try:
                answer = worker.ask({"do": "fuzz", "target": name, "inputs": inputs - done, "seed": seed,
                                     "limit": self._limits[name] * (inputs - done)})  # fmt: skip
            except _DeadError as dead:
                worker = _Worker()
                findings.append(Finding(dead.how, dead.content, f"the process died: {dead.how}\n{dead.stacks}"))
                done += 0 if dead.number == JOURNAL_IDLE else dead.number + 1
                continue
            done += answer["inputs"]
            outcome.seconds += answer["seconds"]
            findings += [Finding(s, base64.b64decode(c), t) for s, c, t in answer["findings"]]
            break
        outcome.inputs += done
        for finding in findings:
            if finding.signature not in outcome.findings:
                worker, outcome.findings[finding.signature] = self._shrink(worker, name, finding)
        return worker

    def _shrink(self, worker: _Worker, name: str, finding: Finding) -> tuple[_Worker, Finding]:
        content = base64.b64encode(finding.content).decode()
        try:
            answer = worker.ask({"do": "shrink", "target": name, "content": content})
        except _DeadError:
            return _Worker(), finding
        if answer["signature"] != finding.signature:
            return worker, finding
        return worker, Finding(finding.signature, base64.b64decode(answer["content"]), finding.trouble)

"""The fuzzing process: it reads jobs as JSON lines on standard input, and replies with JSON lines."""

from __future__ import annotations

import base64
import faulthandler
import json
import logging
import os
import resource
import sys
import time
from pathlib import Path
from typing import Any

from tests.fuzz.machines import load
from tests.fuzz.run import JOURNAL_IDLE, STACKS, Journal, fuzz
from tests.fuzz.shrink import shrunk
from tests.fuzz.target import Subject
from tests.fuzz.targets import TARGETS


def main() -> None:
    """Run jobs until the input ends."""
    logging.disable()
    load()
    path = Path(sys.argv[1])
    journal = Journal(path)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.enable(path.with_name(STACKS).open("w"))  # stays open until the process exits
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    subjects: dict[str, Subject] = {}
    for line in sys.stdin:
        work = json.loads(line)
        journal.write(JOURNAL_IDLE, b"")
        name = work["target"]
        if name not in subjects:
            subjects.clear()
            subjects[name] = TARGETS[name].make()
        begun = time.monotonic()
        answer: dict[str, Any]
        if work["do"] == "shrink":
            signature, content = shrunk(subjects[name], base64.b64decode(work["content"]))
            answer = {"signature": signature, "content": base64.b64encode(content).decode()}
        else:
            findings, inputs = fuzz(subjects[name], work["inputs"], work["seed"], journal.write, work["limit"])
            answer = {
                "inputs": inputs,
                "seconds": time.monotonic() - begun,
                "findings": [(f.signature, base64.b64encode(f.content).decode(), f.trouble) for f in findings],
            }
        journal.write(JOURNAL_IDLE, b"")
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()

"""Counts received frames that contain the number of their tick; runs on each side's Python."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from typing import Any, TextIO


class Tally:
    """Counts the ticks of which all frames have arrived.

    Args:
        frames: number of frames per tick.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._whole: set[int] = set()
        self.messages = self.short = 0

    def see(self, ticks: list[int]) -> None:
        """Count a message, given by the ticks of its frames."""
        self.messages += 1
        if len(ticks) < self._frames:
            self.short += 1
        else:
            self._whole.add(min(ticks))

    def report(self) -> dict[str, int]:
        """Return the counts so far."""
        return {"messages": self.messages, "ticks": len(self._whole), "short": self.short}


def only_answers() -> TextIO:
    """Reserve standard output for answers, and redirect other output to standard error."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    return answers


def serve(answers: TextIO, commands: dict[str, Callable[..., dict[str, Any]]]) -> None:
    """Execute commands, one per line, until the input ends."""
    for line in sys.stdin:
        command = json.loads(line)
        do = command.pop("do")
        if do == "exit":
            return
        try:
            answer = {"ok": True, **commands[do](**command)}
        except Exception as err:
            answer = {"ok": False, "error": f"{type(err).__name__}: {err}"}
        answers.write(json.dumps(answer) + "\n")

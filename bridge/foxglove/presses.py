"""The last press of each person's control, across connections and restarts of the worker.

An app has no message for a released control: it is silent, or sends zero. While it is not connected, its silence shows
nothing. So a control that was held at the last message counts as held until it is released on a new connection.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import partial

from bridge.modules.host import Host

MOST_PERSONS = 100
"""Maximum number of persons whose last press is stored."""


@dataclass(slots=True)
class Press:
    """A press of a control.

    Attributes:
        pressed: when it began, seconds of `bridge.clock.steady`.
        arrived: when the last velocity arrived.
        held: whether that velocity was not zero.
        refused: whether the control must be pressed again before it drives.
    """

    pressed: float = -math.inf
    arrived: float = -math.inf
    held: bool = False
    refused: bool = False


class Presses:
    """The last presses, by person. Used only on the worker's thread.

    A file contains the persons whose control was held. Without it, a held control would drive on after a STOP and a
    restart of the worker.
    """

    def __init__(self, host: Host) -> None:
        self._file, self._submit = host.folder / "held", host.background.submit
        self._stored = self._read()
        self._presses = {person: Press(pressed=0.0, held=True, refused=True) for person in self._stored}

    def held_by(self, person: str) -> Press | None:
        """Return a person's last press if the control was not released; None otherwise."""
        press = self._presses.get(person)
        return press if press is not None and press.held else None

    def note(self, person: str, press: Press) -> None:
        """Store the press of a person who sends a velocity; zero on one connection does not release another."""
        if press.held:
            self._presses.pop(person, None)
            self._presses[person] = press
            while len(self._presses) > MOST_PERSONS:
                del self._presses[next(iter(self._presses))]
        held = [name for name, last in self._presses.items() if last.held]
        if set(held) != set(self._stored):
            self._stored = held
            self._submit(lambda: partial(self._write, self._stored), lambda _: None)

    def _read(self) -> list[str]:
        try:
            persons = json.loads(self._file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return []
        return [str(person) for person in persons][:MOST_PERSONS] if isinstance(persons, list) else []

    def _write(self, persons: list[str]) -> None:
        self._file.write_text(json.dumps(persons), encoding="utf-8")

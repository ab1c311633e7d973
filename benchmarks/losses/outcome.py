"""The cost of one loss, from the messages that the programs received."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from typing_extensions import override

from benchmarks.losses.field import ANCHORS, JOINER, Field, Flow

GAP = 0.5
"""Seconds of silence of a 50 Hz stream that count as an interruption; a busy machine causes shorter silences."""
QUIET = 1.5
"""Seconds without an interruption after which a flow counts as steady."""
STALE = 0.75
"""Seconds after which a command must no longer be delivered: its time-out of 0.5 s, plus the transport."""
STATE_SECONDS = 10.0  # within which every subscriber must have the newest latched lines

Sound = tuple[float, float, float]


@dataclass(slots=True)
class Outcome:
    """The cost of one loss.

    Attributes:
        recovered: whether all messages flow again.
        seconds: time until all messages flowed, from the moment at which they could.
        slowest: the flow that recovered last.
        gap: longest silence of any flow.
        stale: commands that were delivered too late.
        late_flows: flows with stale commands.
        twice: stream messages that arrived twice.
        missing: latched lines that an old or a new subscriber does not have.
        left: leftovers on the networks: registrations and latched lines of dead nodes.
    """

    recovered: bool = True
    seconds: float = 0.0
    slowest: str = ""
    gap: float = 0.0
    stale: int = 0
    late_flows: list[str] = field(default_factory=list)
    twice: int = 0
    missing: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Whether all messages flow again, without any fault."""
        return self.recovered and not (self.stale or self.twice or self.missing or self.left)

    @override
    def __str__(self) -> str:
        text = f"{self.seconds:6.2f} s, longest silence {self.gap:6.2f} s {self.slowest}"
        if not self.recovered:
            text = f"NOT RECOVERED: {self.slowest}"
        more = [f"{self.stale} stale commands ({', '.join(self.late_flows)})"] if self.stale else []
        more += [f"{self.twice} messages twice"] if self.twice else []
        more += [f"missing: {', '.join(self.missing)}"] if self.missing else []
        more += [f"left: {', '.join(self.left)}"] if self.left else []
        return "; ".join([text, *more])


class Watch:
    """Watches a field from a moment before the loss."""

    def __init__(self, a_field: Field) -> None:
        self._field = a_field
        self.since = time.monotonic()

    def until_steady(self, returned: float, seconds: float = 40.0) -> Outcome:
        """Wait until all flows are steady again, and return the outcome.

        Args:
            returned: the moment from which on all messages could flow again.
            seconds: time-out.
        """
        end = time.monotonic() + seconds
        while True:
            now = time.monotonic()
            sounds = self._field.sounds(self.since - GAP)
            flows = self._field.flows()
            bad = [flow for flow in flows if not _is_steady(sounds.get(flow, ()), now)]
            if not bad and now > returned + QUIET:
                break
            if now > end:
                names = ", ".join(f"{listener} receives no {topic}" for listener, topic in bad)
                return Outcome(recovered=False, seconds=now - returned, slowest=names)
            time.sleep(0.1)
        outcome = Outcome()
        for flow in flows:
            self._add(outcome, flow, sounds[flow], returned)
        return outcome

    @staticmethod
    def _add(outcome: Outcome, flow: Flow, sounds: Sequence[Sound], returned: float) -> None:
        arrivals = [s[0] for s in sounds]
        for before, after in itertools.pairwise(arrivals):
            outcome.gap = max(outcome.gap, after - before)
            if after - before > GAP and after - returned > outcome.seconds:
                outcome.seconds, outcome.slowest = after - returned, f"({flow[0]} receives {flow[1]})"
        if arrivals and arrivals[0] - returned > outcome.seconds:  # the first message arrived late
            outcome.seconds, outcome.slowest = arrivals[0] - returned, f"({flow[0]} receives {flow[1]})"
        if flow[1].endswith("/cmd_vel"):
            late = [arrival - sent for arrival, sent, _ in sounds if arrival - sent > STALE]
            outcome.stale += len(late)
            if late:
                outcome.late_flows.append(f"{flow[0]} receives {flow[1]} up to {max(late):.1f} s late")
        if flow[1].endswith("/stream"):
            counts = Counter((sent, number) for _, sent, number in sounds)
            outcome.twice += sum(n - 1 for n in counts.values())

    def check_state(self, outcome: Outcome, seconds: float = STATE_SECONDS) -> None:
        """Check that old and new subscribers of each side have exactly the newest latched line of each program."""
        end = time.monotonic() + seconds
        while True:
            missing, left = self._compare()
            if not (missing or left) or time.monotonic() > end:
                outcome.missing += missing
                outcome.left += left
                return
            time.sleep(0.2)

    def _compare(self) -> tuple[list[str], list[str]]:
        missing, left = list[str](), list[str]()
        wanted = self._field.states
        for name in ANCHORS:
            lines: Mapping[str, str] = self._field.command(name, "states", "states")["lines"]
            missing += [
                f"{line} at {name}, which has {lines.get(n, 'none')}"
                for n, line in wanted.items()
                if n != name and lines.get(n) != line
            ]
        for name in (JOINER, "ros2", "hub"):
            expected = {line for n, line in wanted.items() if n != name or name == "ros2"}
            lingering = {line for line, until in self._field.lingering.items() if time.monotonic() < until}
            count = len(expected | lingering)
            got = self._field.command(name, "late", "joined", count=count, seconds=2.0)["lines"]
            missing += [f"{line} at a late joiner on {name}" for line in sorted(expected - set(got))]
            left += [f"{line} at a late joiner on {name}" for line in sorted(set(got) - expected - lingering)]
            left += [f"{line} {n} times at a late joiner on {name}" for line, n in Counter(got).items() if n > 1]
        return missing, left


def _is_steady(sounds: Sequence[Sound], now: float) -> bool:
    """Return whether there was no recent interruption."""
    late = [s[0] for s in sounds if s[0] > now - QUIET]
    times = [now - QUIET, *late, now]
    return len(late) > 1 and all(b - a < GAP for a, b in itertools.pairwise(times))

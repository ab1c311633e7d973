"""Plays bags, message by message, each when it is due.

Commands are never late, latched or queued: a late command is dropped, except zero velocity, and a step skips commands.
Zero velocity is sent at the end, on a pause and on a stop.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Protocol

from bridge.bags.play.source import PlayMessage
from bridge.bags.play.timeline import Due, Timeline
from bridge.bags.play.topics import PlayTopic
from bridge.hub.errors import HubClosedError, HubError
from bridge.messages.errors import ConversionError
from bridge.messages.velocities import is_zero

COMMAND_LATE = 0.1
"""Delay in seconds above which a command is too late to be published, unless it stops the robot."""

LEAST_SECONDS = 0.1
"""Minimum duration of a loop, so that a bag of one message is not played without a pause."""

_NS = 1_000_000_000


class Messages(Protocol):
    """The messages to play: `bridge.bags.play.source.PlaySource`."""

    begin_ns: int
    end_ns: int
    bad: list[tuple[PlayTopic, str]]
    troubles: list[str]

    def kept(self) -> list[PlayMessage]:
        """Return the messages to publish at the start: static transforms and latched messages."""
        ...

    def messages(self) -> Iterator[PlayMessage]:
        """Yield all other messages in order of time."""
        ...


class PlayOutput(Protocol):
    """The destination: `bridge.bags.play.output.HubOutput`."""

    def put(self, topic: PlayTopic, data: bytes) -> None:
        """Publish a message, serialized as CDR."""
        ...

    def clock(self, time_ns: int) -> None:
        """Publish the bag's time, in nanoseconds since 1970."""
        ...

    def end_velocities(self) -> bool:
        """Command zero velocity on each topic with a played velocity."""
        ...


class Player:
    """Plays once, or repeatedly until it is stopped.

    Args:
        report: called with messages for people, on the playing thread.

    Attributes:
        played: number of messages by topic.
        dropped: number of messages that were not played, by topic and reason: ``late``, ``stepped``, ``paused``,
            ``bad``.
        loops: number of completed runs.
    """

    def __init__(
        self, source: Messages, output: PlayOutput, timeline: Timeline, *, loop: bool = False,
        report: Callable[[str], object] = lambda _: None,
    ) -> None:  # fmt: skip
        self._source, self._output, self.timeline = source, output, timeline
        self._loop, self._report = loop, report
        self.played: Counter[str] = Counter()
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.loops = 0
        self._reported = 0.0

    def run(self) -> None:
        """Play; raises `bridge.bags.bag.BagError` for a damaged bag, `HubError` if the hub is lost."""
        try:
            while self._once() and self._loop:
                pass
        finally:
            with contextlib.suppress(HubError):
                self._output.end_velocities()

    def _once(self) -> bool:
        """Play from start to end; return False if the play was stopped."""
        source, timeline = self._source, self.timeline
        kept = source.kept()
        for topic, reason in source.bad:
            self._drop(topic, "bad", reason)
        for reason in source.troubles:
            self._report(reason)
        source.bad.clear()
        source.troubles.clear()
        timeline.begin(source.begin_ns)
        self._output.clock(source.begin_ns)
        for message in kept:
            self._publish(message.topic, message.data, ready=message.ready)
        for message in source.messages():
            if not self._play(message):
                return False
        end = source.end_ns
        if self._loop:
            end = max(end, source.begin_ns + int(LEAST_SECONDS * timeline.rate * _NS))
        if self._await(end) is Due.STOPPED:
            return False
        self._output.end_velocities()
        self._output.clock(end)
        self.loops += 1
        return True

    def _await(self, time_ns: int) -> Due:
        """Wait until the bag's time reaches ``time_ns``, or a step or a stop."""
        while True:
            due = self.timeline.next(time_ns)
            if due is Due.CLOCK:
                self._output.clock(self.timeline.now_ns())
            elif due is Due.PAUSED:
                self._output.end_velocities()
            else:
                return due

    def _play(self, message: PlayMessage) -> bool:
        """Play a message when it is due; return False if the play is stopped."""
        topic = message.topic
        due = self._await(message.time_ns)
        if due is Due.STOPPED:
            return False
        if topic.command and due is Due.STEP:
            self._drop(topic, "stepped")
            self.timeline.step()  # apply the step to the next message
            return True
        late = topic.command and self.timeline.late > COMMAND_LATE
        self._publish(topic, message.data, ready=message.ready, late=late)
        if due is Due.STEP:
            self._output.clock(self.timeline.now_ns())
        self._report_lag()
        return True

    def _publish(self, topic: PlayTopic, data: bytes, *, ready: bool, late: bool = False) -> None:
        try:
            cdr = topic.convert(data) if topic.convert is not None and not ready else data
            if late and not is_zero(topic.type_name, cdr):
                self._drop(topic, "late")
                return
            if not topic.command:
                self._output.put(topic, cdr)
            elif not self.timeline.publish(lambda: self._output.put(topic, cdr)):
                self._drop(topic, "paused")
                return
        except HubClosedError:
            raise
        except (ConversionError, HubError) as err:
            self._drop(topic, "bad", str(err))
        else:
            self.played[topic.name] += 1

    def _drop(self, topic: PlayTopic, reason: str, why: str = "") -> None:
        self.dropped[topic.name, reason] += 1
        if why and self.dropped[topic.name, reason] == 1:
            self._report(f"{topic.name}: a message was skipped: {why}")

    def _report_lag(self) -> None:
        """Report that the play cannot keep up, and again whenever the lag has doubled."""
        behind = self.timeline.behind
        if behind > 2 * self._reported:
            self._reported = behind
            self._report(f"playback cannot keep up with a rate of {self.timeline.rate:g}: {behind:.1f} s behind so far")

"""Reports of what a demo program received, as JSON lines on its output, and commands on its input.

A program exits at the end of its input, so that no program remains if the demo dies, not even one that waits
indefinitely for a dead process, as rospy waits for its master.
"""

from __future__ import annotations

import json
import queue
import signal
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from typing import Any

from bridge.demo.topics_demo import messages

EVERY = 0.5
"""Seconds between two reports."""

LAST_SECONDS = 4
"""Seconds after the end of its input at which the system ends a program that is still running, even if it hangs."""

_REMEMBERED = 2000


class TopicReceived:
    """The messages that a program received on one topic."""

    def __init__(self) -> None:
        self.count = 0
        self.repeated = 0
        self.detail = ""
        self._lock = threading.Lock()
        self._keys: OrderedDict[Hashable, None] = OrderedDict()

    def add(self, key: Hashable, detail: str) -> None:
        """Count a message; a repeated key is a duplicate in transit (None: messages cannot be distinguished)."""
        with self._lock:
            self.count += 1
            self.detail = detail
            if key is None:
                return
            if key in self._keys:
                self.repeated += 1
            self._keys[key] = None
            if len(self._keys) > _REMEMBERED:
                self._keys.popitem(last=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the entry for a report."""
        with self._lock:
            return {"count": self.count, "repeated": self.repeated, "detail": self.detail}


class TopicsProgram:
    """A program that publishes greetings, drives, and joins late; each side has one, except ROS 1, the robot's side."""

    def __init__(self) -> None:
        self._pose: list[float] | None = None
        self._static_frames: set[str] = set()
        self.reporter = Reporter(lambda: {"pose": self._pose})

    def join_late(self) -> None:
        """Subscribe to topics that were published once, long ago."""
        raise NotImplementedError

    def drive(self, linear: float, angular: float, seconds: float) -> None:
        """Publish a velocity for a few seconds, then stop; report the robot's pose before and after."""
        self._send_velocity(self._send, linear, angular, seconds)

    def close(self) -> None:
        raise NotImplementedError

    def _send(self, linear: float, angular: float) -> None:
        raise NotImplementedError

    def _publish_hello(self, text: str) -> None:
        raise NotImplementedError

    def _send_velocity(
        self, send: Callable[[float, float], object], linear: float, angular: float, seconds: float
    ) -> None:
        before, sent = self._pose, 0
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            send(linear, angular)
            sent += 1
            time.sleep(1 / messages.DRIVE_RATE)
        self.reporter.write("drove", before=before, after=self._pose, sent=sent)

    def say_hello(self, who: str, ended: threading.Event) -> None:
        """Publish a greeting periodically until the event is set."""
        number = 0
        while not ended.wait(1 / messages.HELLO_RATE):
            number += 1
            self._publish_hello(f"hello {number} from {who}")

    def _odometry(self, message: Any) -> str:
        self._pose = messages.pose(message)
        return messages.position(message)

    def _mounts(self, message: Any) -> str:
        return self._add_mounts(t.child_frame_id for t in message.transforms)

    def _add_mounts(self, frames: Iterable[str]) -> str:
        self._static_frames.update(frames)
        return ", ".join(sorted(self._static_frames))


def serve(program: TopicsProgram, who: str) -> None:
    """Run a program until standard input ends."""
    ended = threading.Event()
    hello = threading.Thread(target=program.say_hello, args=(who, ended), name="hello", daemon=True)
    hello.start()
    try:
        program.reporter.write("ready")
        program.reporter.run({"drive": program.drive, "join_late": program.join_late})
    finally:
        ended.set()
        hello.join(2.0)
        program.close()


class Reporter:
    """A program's connection to the demo, opened before anything that may block; ``more`` returns further keys."""

    def __init__(self, more: Callable[[], dict[str, Any]] | None = None) -> None:
        self._received: dict[str, TopicReceived] = {}
        self._more = more
        self._write_lock = threading.Lock()
        self._ended = threading.Event()
        self._commands: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, name="commands", daemon=True).start()

    def received(self, topic: str) -> TopicReceived:
        """Return what was received on a topic so far."""
        return self._received.setdefault(topic, TopicReceived())

    def write(self, event: str, **values: Any) -> None:
        """Write one line."""
        with self._write_lock:
            sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
            sys.stdout.flush()

    def run(self, commands: dict[str, Callable[..., None]]) -> None:
        """Report periodically, and run commands until the input ends; each command runs on this thread."""
        reporter = threading.Thread(target=self._report, name="report", daemon=True)
        reporter.start()
        try:
            while (line := self._commands.get()) is not None:
                command = json.loads(line)
                commands[command.pop("do")](**command)
        finally:
            self._ended.set()
            reporter.join(2.0)

    def _read(self) -> None:
        # unbuffered: a thread that reads sys.stdin holds its lock at Python's exit
        with open(0, "rb", buffering=0, closefd=False) as lines:
            for line in lines:
                self._commands.put(line)
        self._commands.put(None)
        signal.alarm(LAST_SECONDS)

    def _report(self) -> None:
        while not self._ended.is_set():
            more = self._more() if self._more is not None else {}
            try:
                self.write(
                    "report",
                    heard={topic: received.as_dict() for topic, received in list(self._received.items())},
                    **more,
                )
            except OSError:
                return  # the demo has closed the pipe
            self._ended.wait(EVERY)

"""A real ROS 1 or ROS 2 program that a test controls with JSON lines on its standard input and output.

Each line is a command, and is answered by one line, in order. Commands (``do``):

``advertise`` topic, type, latched, best_effort, depth -> id; ``publish`` id, message (a dict of the fields), times;
``subscribe`` topic, type, latched, best_effort, depth -> id; ``wait`` id, count, seconds, since -> messages (all so far
except the first ``since``, after ``count`` have arrived or the time is over); ``drop`` id; ``graph`` -> topics {name:
[types]}, publishers {topic: [nodes]}, subscriptions {topic: [nodes]}; ``count`` id, first, count, rate: publish
``count`` ``std_msgs/String`` with numbers from ``first`` on, ``rate`` a second, on a thread; ``counted`` id, now: wait
until it has finished (or stop it now) -> sent; ``tally`` id, since -> received, distinct numbers, ``last``:
``time.monotonic()`` at the last arrival, ``silence``: the longest time between two arrivals from ``since`` on,
``begun``: when that began; ``silence`` id, since -> last, silence, begun, for any type; ``broadcast`` id, child, rate
(ROS 1): transforms from ``map`` to ``child`` until ``counted``; ``join`` type, published, subscribed (topics): latched
endpoints, created at once; each topic's name is published on it -> publishers, subscriptions {topic: id}, begun, ended
(``time.monotonic()``).

A reply has ``ok``; if it is false, ``error``.

Services: ``serve`` service, type, reply (fields of the response), error (a text with which calls fail), held (it
answers only after ``release`` id) -> id; ``requests`` id, count, seconds -> requests (all so far, after ``count`` have
arrived or the time is over); ``call`` service, type, request, persistent (ROS 1) -> id: a call that runs on a thread;
``result`` id, seconds -> done, reply (None if it failed), error (its text, else ""), at (``time.monotonic()``).

ROS 2: ``requests`` of ``call`` makes several calls at once (``replies`` of ``result``), ``echo`` of ``serve`` copies
fields of the request into the reply ({to: from}), a server with ``error`` never answers.

Actions: ``act`` action, type, feedback (a list; ``times`` over, one round each ``period`` seconds), result, outcome
(``succeed``, ``abort``, ``reject``), held, keeps (it rejects cancels) -> id; ``goals`` id, count, seconds -> goals;
``send_goal`` action, type, goal -> id; ``goal`` id, until (required values of fields), seconds -> accepted, feedback,
status, result, cancel ([return_code, goals]), ends (how many ends were reported), ``ended_at`` (``time.monotonic()`` of
the last one); ``ask_result`` id (ROS 2): request the result again; ``cancel`` id.

Types are spelled ``package/Name`` on all sides.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.support.process import Process

if TYPE_CHECKING:
    from tests.support.netns import Machine


class Peer(Process):
    """A peer program under the test's control."""

    def __init__(self, program: Path, python: Path, env: Mapping[str, str], *args: str) -> None:
        super().__init__([python, program, *args], env, pipes=True)

    def ask(self, do: str, **params: Any) -> dict[str, Any]:
        """Send one command, and return its reply; fail with the program's error."""
        assert self.popen.stdin is not None
        assert self.popen.stdout is not None
        self.popen.stdin.write(json.dumps({"do": do, **params}) + "\n")
        self.popen.stdin.flush()
        line = self.popen.stdout.readline()
        assert line, f"peer ended during {do}: {self.output()[-3000:]}"
        answer: dict[str, Any] = json.loads(line)
        assert answer.get("ok"), f"{do} {params}: {answer.get('error')}"
        return answer

    def advertise(self, topic: str, type_: str, **qos: Any) -> int:
        """Advertise a topic, and return the endpoint's id."""
        return int(self.ask("advertise", topic=topic, type=type_, **qos)["id"])

    def subscribe(self, topic: str, type_: str, **qos: Any) -> int:
        """Subscribe to a topic, and return the endpoint's id."""
        return int(self.ask("subscribe", topic=topic, type=type_, **qos)["id"])

    def publish(self, endpoint: int, message: dict[str, Any], times: int = 1) -> None:
        """Publish a message, given by its fields, ``times`` times in a row."""
        self.ask("publish", id=endpoint, message=message, times=times)

    def wait(self, endpoint: int, count: int, seconds: float = 40.0, since: int = 0) -> list[dict[str, Any]]:
        """Return all messages so far except the first ``since``, after ``count`` have arrived or the time is over."""
        answer = self.ask("wait", id=endpoint, count=count, seconds=seconds, since=since)
        messages: list[dict[str, Any]] = answer["messages"]
        return messages

    def drop(self, endpoint: int) -> None:
        """Close one endpoint."""
        self.ask("drop", id=endpoint)

    def graph(self) -> dict[str, Any]:
        """Return the side's graph as the program sees it."""
        return self.ask("graph")

    def end(self) -> None:
        """Let the program exit by itself, without waiting for it."""
        if self.popen.stdin is not None:
            with contextlib.suppress(OSError):
                self.popen.stdin.close()

    def stop(self, seconds: float = 6.0) -> int:
        """Let the program exit by itself, so that it cleans up; with 0 ``seconds``, kill it at once."""
        if seconds > 0 and self.popen.poll() is None:
            self.end()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.popen.wait(seconds / 2)
        return super().stop(seconds)


def on_machine(machine: Machine, env: Mapping[str, str], python: Path | str, *words: Path | str) -> Peer:
    """Start a peer program on a simulated machine."""
    ip, netns, *command = machine.command(python, *words)
    return Peer(Path(netns), Path(ip), env, *command)


def stop_all(things: Sequence[Any]) -> None:
    """Stop programs, workers and sessions, last one first; programs exit concurrently, because rospy's are slow.

    An error does not keep the others running.
    """
    for thing in things:
        if isinstance(thing, Peer):
            thing.end()
    with contextlib.ExitStack() as stack:
        for thing in things:
            stack.callback(thing.stop)

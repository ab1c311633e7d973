"""Common parts of the programs of `tests.peers.peer`: the loop that executes commands, and records of arrivals.

This module needs only Python's standard library, because ROS 1 programs import it on the system's Python.
"""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import itertools
import json
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any, TextIO


class Record:
    """Messages, requests or goals, in the order of their arrival.

    Args:
        plain: converts an item to JSON values.
    """

    def __init__(self, plain: Callable[[Any], Any] = lambda item: item) -> None:
        self._plain = plain
        self.items: list[Any] = []
        self._times: list[float] = []
        self._changed = threading.Condition()

    def add(self, item: Any) -> None:
        """Append an item, and wake those who wait for it."""
        with self._changed:
            self.items.append(item)
            self._times.append(time.monotonic())
            self._changed.notify_all()

    def wait(self, count: int = 1, seconds: float = 40.0, since: int = 0) -> list[Any]:
        """Return all items except the first ``since``, after ``count`` have arrived or the time is over."""
        with self._changed:
            self._changed.wait_for(lambda: len(self.items) >= count, seconds)
            return [self._plain(item) for item in self.items[since:]]

    def silence(self, since: float) -> dict[str, float]:
        """Return the time of the last arrival, and the longest time without one from ``since`` on and its begin."""
        with self._changed:
            times = list(self._times)
        later = [since, *(at for at in times if at >= since)]
        pauses = ((after - before, before) for before, after in itertools.pairwise(later))
        silence, begun = max(pauses, default=(0.0, since))
        return {"last": times[-1] if times else 0.0, "silence": silence, "begun": begun}


class Calling:
    """A call that runs on a thread, and its reply or error."""

    def __init__(self, call: Callable[[], Any]) -> None:
        self._call = call
        self._reply: Any = None
        self._error, self._at = "", 0.0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._reply = self._call()
        except Exception as err:
            self._error = str(err) or type(err).__name__
        self._at = time.monotonic()

    def result(self, seconds: float = 40.0) -> dict[str, Any]:
        """Return the outcome so far, once the call has ended or the time is over."""
        self._thread.join(seconds)
        return {"done": not self._thread.is_alive(), "reply": self._reply, "error": self._error, "at": self._at}


class GoalRecord:
    """The state of an action client's goal, with its feedback and result."""

    def __init__(self) -> None:
        self.state: dict[str, Any] = {"accepted": None, "feedback": [], "status": 0, "result": None, "cancel": None}
        self.state |= {"ends": 0, "ended_at": 0.0}
        self._changed = threading.Condition()

    def update(self, **values: Any) -> None:
        """Set values of the state, and wake those who wait for them."""
        with self._changed:
            self.state.update(values)
            self._changed.notify_all()

    def add_feedback(self, feedback: Any) -> None:
        """Append a feedback message."""
        self.update(feedback=[*self.state["feedback"], feedback])

    def wait(self, until: dict[str, Any], seconds: float = 40.0) -> dict[str, Any]:
        """Return the state, once each field of ``until`` has its value (at least as much feedback) or time is over."""

        def reached() -> bool:
            state = {**self.state, "feedback": len(self.state["feedback"])}
            return all(state[k] >= v if k == "feedback" else state[k] == v for k, v in until.items())

        with self._changed:
            self._changed.wait_for(reached, seconds)
            return dict(self.state)


class Counting:
    """Calls a function at a rate on a thread, each time with the next number as text."""

    def __init__(self, publish: Callable[[str], Any], first: int, count: float, rate: float) -> None:
        self._publish, self._sent, self._stopping = publish, 0, threading.Event()
        self._thread = threading.Thread(target=self._run, args=(first, count, rate), daemon=True)
        self._thread.start()

    def _run(self, first: int, count: float, rate: float) -> None:
        due = time.monotonic()
        while self._sent < count and not self._stopping.is_set():
            self._publish(str(first + self._sent))
            self._sent += 1
            due += 1.0 / rate
            self._stopping.wait(max(0.0, due - time.monotonic()))

    def end(self, *, now: bool) -> int:
        """Wait until all calls are made, or stop now; return the number of calls."""
        if now:
            self._stopping.set()
        self._thread.join()
        return self._sent


class Commands:
    """Executes each command with the method of the same name; a command's ``id`` selects a part of the program.

    Parts are publishers, subscriptions, services, calls, action servers and goals.
    """

    def __init__(self) -> None:
        self.parts: dict[int, Any] = {}
        self._numbers = itertools.count(1)
        self.countings: dict[int, Counting] = {}

    def ask(self, do: str, **params: Any) -> dict[str, Any]:
        """Execute a command."""
        answer: dict[str, Any] = getattr(self, do)(**params)
        return answer

    def add(self, part: Any) -> dict[str, int]:
        """Store a part, and reply with its number."""
        number = next(self._numbers)
        self.parts[number] = part
        return {"id": number}

    def advertise(self, topic: str, type: str, **qos: Any) -> dict[str, Any]:
        """Create a publisher."""
        raise NotImplementedError

    def subscribe(self, topic: str, type: str, **qos: Any) -> dict[str, Any]:
        """Create a subscription."""
        raise NotImplementedError

    def publish(self, id: int, message: dict[str, Any], times: int = 1) -> dict[str, Any]:
        """Publish a message."""
        raise NotImplementedError

    def join(self, type: str, published: list[str], subscribed: list[str]) -> dict[str, Any]:
        """Create many latched endpoints at once, and publish each topic's name on it."""
        begun, publishers = time.monotonic(), {}
        for topic in published:
            publishers[topic] = self.advertise(topic=topic, type=type, latched=True)["id"]
            self.publish(id=publishers[topic], message={"data": topic})
        subscriptions = {topic: self.subscribe(topic=topic, type=type, latched=True)["id"] for topic in subscribed}
        return {
            "publishers": publishers, "subscriptions": subscriptions, "begun": begun, "ended": time.monotonic(),
        }  # fmt: skip

    def count(self, id: int, first: int, count: float, rate: float) -> dict[str, Any]:
        self.countings[id] = Counting(lambda text: self.publish(id, {"data": text}), first, count, rate)
        return {}

    def counted(self, id: int, now: bool = False) -> dict[str, Any]:
        return {"sent": self.countings.pop(id).end(now=now)}

    def wait(self, id: int, count: int, seconds: float, since: int = 0) -> dict[str, Any]:
        return {"messages": self.parts[id].wait(count, seconds, since)}

    def tally(self, id: int, since: float = 0.0) -> dict[str, Any]:
        numbers = [int(message.data) for message in list(self.parts[id].items)]
        return {"received": len(numbers), "distinct": len(set(numbers)), **self.silence(id, since)}

    def silence(self, id: int, since: float = 0.0) -> dict[str, Any]:
        silence: dict[str, Any] = self.parts[id].silence(since)
        return silence

    def requests(self, id: int, count: int = 1, seconds: float = 40.0) -> dict[str, Any]:
        return {"requests": self.parts[id].wait(count, seconds)}

    def goals(self, id: int, count: int = 1, seconds: float = 40.0) -> dict[str, Any]:
        return {"goals": self.parts[id].wait(count, seconds)}

    def release(self, id: int) -> dict[str, Any]:
        self.parts[id].release()
        return {}

    def result(self, id: int, seconds: float = 40.0) -> dict[str, Any]:
        result: dict[str, Any] = self.parts[id].result(seconds)
        return result

    def goal(self, id: int, until: dict[str, Any] | None = None, seconds: float = 40.0) -> dict[str, Any]:
        state: dict[str, Any] = self.parts[id].wait(until or {}, seconds)
        return state

    def cancel(self, id: int) -> dict[str, Any]:
        self.parts[id].cancel()
        return {}

    def drop(self, id: int) -> dict[str, Any]:
        self.parts.pop(id).drop()
        return {}


def only_answers() -> TextIO:
    """Reserve standard output for answers, and redirect other output to standard error."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    return answers


def serve(commands: Commands, answers: TextIO) -> None:
    """Execute the commands from standard input, one JSON object per line, until it ends."""
    for line in sys.stdin:
        try:
            answer = {"ok": True, **commands.ask(**json.loads(line))}
        except Exception as err:
            traceback.print_exc()
            answer = {"ok": False, "error": f"{type(err).__name__}: {err}"}
        answers.write(json.dumps(answer) + "\n")

"""``midspan action send``: one goal, its feedback and its result."""

from __future__ import annotations

import argparse
import base64
import signal
import sys
import threading
import time
import uuid
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Self

from bridge.cli.calling import Caller, spelled, type_and_values
from bridge.cli.decode import Types
from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client, open_client
from bridge.cli.text import clean
from bridge.cli.topic_pub import yaml_fields
from bridge.cli.topic_view import absolute
from bridge.cli.yaml_text import json_line, message_text
from bridge.hub.call import CallError
from bridge.hub.qos import Qos
from bridge.hub.subscription import HubSample
from bridge.messages.errors import ConversionError

SUCCEEDED = 4
STATES = {4: "succeeded", 5: "canceled", 6: "aborted"}
_LONGEST = 3600.0


class _Feedback(NamedTuple):
    cdr: bytes


class _End(NamedTuple):
    reply: dict[str, Any] | CallError


def send(args: argparse.Namespace) -> int:
    """Send a goal and follow it; the exit code."""
    type_name, values = type_and_values(args.goal)
    goal = yaml_fields(values)
    with open_client(args) as client, Interrupt() as interrupt:
        sent = SentGoal(client, absolute(args.name), spelled(type_name, "action"), interrupt)
        try:
            sent.begin(goal)
            end = sent.follow(args.timeout, lambda feedback: _show(feedback, args))
        except KeyboardInterrupt:
            end = _give_up(sent, args, "Ctrl-C")
        except TimeoutError:
            end = _give_up(sent, args, f"{args.timeout:g} s are over")
        return _tell_end(end, args)


class Interrupt:
    """Keeps the first Ctrl-C until `check` raises it: raised where it comes, foreign code might swallow it.

    The second one is raised at once.
    """

    def __init__(self) -> None:
        self._came = self._told = False
        self._before: Any = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._take)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _take(self, _number: int, _frame: object) -> None:
        if self._came:
            raise KeyboardInterrupt
        self._came = True

    def check(self) -> None:
        """Raise `KeyboardInterrupt`, once, where it has come."""
        if self._came and not self._told:
            self._told = True
            raise KeyboardInterrupt


class SentGoal:
    """A goal that is sent.

    Args:
        client: the session.
        name: the action.
        type_name: as ROS 2 spells it, "" for what its server has.
        interrupt: keeps Ctrl-C.

    Attributes:
        id: its 16 bytes.
        type_name: the action's type.

    Raises:
        CliError: there is no such action, or its type is not known.
    """

    def __init__(self, client: Client, name: str, type_name: str, interrupt: Interrupt) -> None:
        types = Types(client)
        part = f"{name}/_action/"
        self.name, self._types, self._interrupt = name, types, interrupt
        self._send = Caller(client, types, f"{part}send_goal", f"{type_name}_SendGoal" if type_name else "")
        self.type_name = self._send.type_name.removesuffix("_SendGoal")
        self._result = Caller(client, types, f"{part}get_result")
        self._cancel = Caller(client, types, f"{part}cancel_goal")
        self.id = uuid.uuid4().bytes
        self._uuid = {"uuid": base64.b64encode(self.id).decode()}
        self._asked = self._cancel_failed = False
        self._news: SimpleQueue[_Feedback | _End] = SimpleQueue()
        self._feedback_type = f"{self.type_name}_FeedbackMessage"
        self._feedback_hash = types.hash_of(self._feedback_type)
        client.hub.subscription(
            f"{part}feedback", self._feedback_type, self._feedback_hash, Qos(depth=100), self._heard
        )

    def begin(self, goal: dict[str, Any]) -> None:
        """Send it and wait for its acceptance; raises `CliError` where it is rejected."""
        reply = self._send.ask({"goal_id": self._uuid, "goal": goal}, check=self._interrupt.check)
        if not reply["accepted"]:
            raise CliError(f"{self.name} rejected the goal")
        self._ask_result()

    def follow(
        self,
        timeout: float | None,
        show: Callable[[dict[str, Any]], None],
        each: Callable[[], None] = lambda: None,
    ) -> dict[str, Any] | CallError:
        """Show feedback until the goal ends; raises `TimeoutError` where that takes longer than it may.

        Args:
            timeout: seconds; None for ever.
            show: gets the feedback.
            each: called at least five times a second.
        """
        end = time.monotonic() + (_LONGEST * 24 * 365 if timeout is None else timeout)
        while True:
            self._interrupt.check()
            if self._cancel_failed:
                self._ask_cancel()
            each()
            try:
                news = self._news.get(timeout=min(0.2, max(end - time.monotonic(), 0.0)) or 0.001)
            except Empty:
                if time.monotonic() >= end:
                    raise TimeoutError from None
                continue
            if isinstance(news, _End):
                return news.reply
            self._read(news.cdr, show)

    def cancel(self) -> None:
        """Ask for its cancellation, also where it is not accepted yet; `follow` asks again where the call fails."""
        self._ask_result()
        self._ask_cancel()

    def _ask_cancel(self) -> None:
        def answered(reply: dict[str, Any] | CallError) -> None:
            self._cancel_failed = isinstance(reply, CallError)

        self._cancel_failed = False
        self._cancel.call({"goal_info": {"goal_id": self._uuid}}, answered)

    def _ask_result(self) -> None:
        if not self._asked:
            self._result.call({"goal_id": self._uuid}, lambda result: self._news.put(_End(result)))
            self._asked = True

    def _heard(self, sample: HubSample) -> None:
        data = sample.data()
        if data[4:20] == self.id:
            self._news.put(_Feedback(data))

    def _read(self, cdr: bytes, show: Callable[[dict[str, Any]], None]) -> None:
        try:
            feedback = self._types.decode(self._feedback_type, self._feedback_hash, cdr)["feedback"]
        except ConversionError as err:
            print(f"# {clean(err)}", file=sys.stderr)
            return
        show(feedback)


def _show(feedback: dict[str, Any], args: argparse.Namespace) -> None:
    if args.no_feedback:
        return
    if args.json:
        print(json_line({"feedback": feedback}), flush=True)
    else:
        print(f"feedback:\n{message_text(feedback, full=args.full)}---", flush=True)


def _give_up(sent: SentGoal, args: argparse.Namespace, why: str) -> dict[str, Any] | CallError:
    """Cancel the goal, and wait for its end."""
    print(f"{why}: the goal is being cancelled; Ctrl-C again does not wait", file=sys.stderr)
    sent.cancel()
    return sent.follow(None, lambda feedback: _show(feedback, args))


def _tell_end(end: dict[str, Any] | CallError, args: argparse.Namespace) -> int:
    if isinstance(end, CallError):
        raise CliError(f"the goal was lost: {clean(end)}")
    state = STATES.get(end["status"], f"state {end['status']}")
    if args.json:
        print(json_line({"status": state, "result": end["result"]}))
    else:
        result = message_text(end["result"], full=args.full) if end["result"] else ""
        print(f"{state}\n{result}", end="")
    return 0 if end["status"] == SUCCEEDED else 1

"""A goal that ``midspan action send`` gives up while the goal's server cannot be called."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from bridge.client.services import ServiceCaller
from bridge.hub.endpoints.calls import CallError
from tests.cli.conftest import Midspan
from tests.cli.graph.test_calls import Robot, robot  # noqa: F401


def test_failed_cancel_request_is_repeated(
    midspan: Midspan,
    robot: Robot,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    attempts, call = list[str](), ServiceCaller.call

    def fails(caller: ServiceCaller, values: dict[str, Any], done: Callable[[Any], None]) -> Callable[[], None]:
        if caller.topic.endswith("cancel_goal"):
            attempts.append(caller.topic)
            if len(attempts) < 3:
                done(CallError("the server left before it answered"))
                return lambda: None
        return call(caller, values, done)

    monkeypatch.setattr(ServiceCaller, "call", fails)
    outcome = midspan("action", "send", "/lookup", "{target_frame: slow}", "--timeout", "0.3")
    assert (outcome.code, outcome.out.split()[0], len(attempts)) == (1, "canceled", 3)

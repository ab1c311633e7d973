"""Decisions on topics and services."""

from __future__ import annotations

import logging

import pytest

from bridge.messages.transcode.conversion import Conversion
from bridge.routing.decision import RouteDecision


def test_an_unexpected_exception_refuses_only_one_route(caplog: pytest.LogCaptureFixture) -> None:
    decision = RouteDecision.one_ended("/odd", "my_msgs/msg/Odd", "")

    def fail() -> Conversion:
        raise OverflowError("too large")

    with caplog.at_level(logging.ERROR):
        assert [decision.convert(fail) for _ in range(3)] == [None] * 3
    assert decision.refused
    assert decision.reason == "my_msgs/msg/Odd cannot be converted: OverflowError: too large"
    (record,) = (record for record in caplog.records if "my_msgs/msg/Odd" in record.getMessage())
    assert record.exc_info is not None

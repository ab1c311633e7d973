"""The newest state of a board, and states that cannot be read."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from yarp_compat.dev.controlboard.client import JointState, _StateReader
from yarp_compat.dev.controlboard.streams import JointData
from yarp_compat.wire.errors import WireError


def received(data: JointData | None, envelope: str = "") -> Any:
    def to(_kind: type[JointData]) -> JointData:
        if data is None:
            raise WireError("the state of a control board has 22 or 24 fields, not 1")
        return data

    return SimpleNamespace(to=to, envelope=envelope, source="/board")


def state(position: float) -> JointData:
    return JointData(1, {"jointPosition": np.array([position])})


def test_a_malformed_state_does_not_renew_the_previous_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    states = JointState(timeout=1.0)
    states.store(received(state(2.0), "7 50.0"))
    assert states.read("jointPosition") == (np.array([2.0]), 50.0)
    clock[0] = 100.75
    states.store(received(None, "8 50.75"))
    assert states.read("jointPosition") == (np.array([2.0]), 50.0)
    clock[0] = 101.5
    assert states.read("jointPosition") is None
    assert states.stamp().getTime() == 50.0
    states.store(received(state(3.0), "no stamp"))
    value = states.read("jointPosition")
    assert value is not None
    assert value[0] == [3.0]


def test_a_malformed_state_is_not_reported_as_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    reported: list[JointData] = []
    reader = _StateReader.__new__(_StateReader)
    reader._state, reader._reported = JointState(timeout=1.0), None
    reader._on_state = lambda data, _seconds: reported.append(data)
    reader.core = SimpleNamespace(profile=None)  # type: ignore[assignment]
    monkeypatch.setattr("yarp_compat.dev.controlboard.client.Received", lambda message, _profile: message)
    first, second = state(1.0), state(2.0)
    for data in (first, None, second):
        reader._on_message(received(data))
    assert reported == [first, second]

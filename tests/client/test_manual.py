"""One person at a time drives manually on a velocity topic of the hub."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.client.manual import ManualControl
from bridge.hub.node import Hub
from bridge.hub.session import HubSession
from tests.peers.hub.quick import QuickHub
from tests.peers.hub.rig import HubRig
from tests.support.wait import until

TOPIC = "/cmd_vel"


@pytest.fixture
def network(tmp_path: Path) -> Iterator[QuickHub]:
    with HubRig(tmp_path) as rig:
        yield rig.hubs


def test_control_is_free_again_when_its_holder_ends_or_leaves(network: QuickHub) -> None:
    with Hub.open(network.settings("one")) as one:
        other = ManualControl(one, TOPIC)
        with Hub.open(network.settings("two")) as two:
            control = ManualControl(two, TOPIC)
            assert (control.rival(), other.rival()) == ("", "")
            control.begin("anna/10.0.0.2 (web)")
            until(lambda: other.rival() == "anna/10.0.0.2 (web) drives manually", "the other program knows the driver")
            assert control.rival() == ""
            assert ManualControl(one, "/robot_2/cmd_vel").rival() == ""
            control.end()
            control.end()
            until(lambda: not other.rival(), "control is free after its end")
            control.begin("anna")
            until(other.rival, "anna drives again")
        until(lambda: not other.rival(), "control is free when the holder's program has left")


def test_one_of_two_that_begin_together_has_precedence(network: QuickHub) -> None:
    with Hub.open(network.settings("one")) as one, Hub.open(network.settings("two")) as two:
        controls = {hub.zid: ManualControl(hub, TOPIC) for hub in (one, two)}
        for zid, control in controls.items():
            control.begin(zid)
        first, last = (controls[zid] for zid in sorted(controls))
        until(last.rival, "the one with the higher zid yields")
        assert first.rival() == ""
        last.end()
        until(lambda: last.rival() == f"{min(controls)} drives manually", "it is refused from then on")


def test_control_is_free_when_the_node_of_a_shared_session_is_closed(network: QuickHub) -> None:
    session = HubSession.open(network.settings("modules"), shared=True)
    with Hub.open(network.settings("one")) as one, contextlib.closing(session):
        other = ManualControl(one, TOPIC)
        for _ in range(2):
            node = Hub.on(session, "gateway", "gateway")
            control = ManualControl(node, TOPIC)
            control.begin("a YARP client")
            until(other.rival, "the other program knows the driver")
            node.close()
            until(lambda: not other.rival(), "control is free although the driver has not ended it")


def test_a_late_end_does_not_withdraw_the_successors_announcement(network: QuickHub) -> None:
    session = HubSession.open(network.settings("modules"), shared=True)
    with Hub.open(network.settings("one")) as one, contextlib.closing(session):
        first, second = (Hub.on(session, "gateway", "gateway") for _ in range(2))
        late, successor = ManualControl(first, TOPIC), ManualControl(second, TOPIC)
        late.begin("a YARP client")
        first.close()
        successor.begin("a YARP client")
        late.end()
        ManualControl(second, "/later").begin("a YARP client")
        until(ManualControl(one, "/later").rival, "the other program has received what came before")
        assert ManualControl(one, TOPIC).rival()

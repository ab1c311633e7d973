"""What is refused in a secured domain: the participant, the presence topic and other endpoints."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from bridge.adapters.ros2 import security
from bridge.messages.errors import MessageTypeError
from tests.peers.ros2.network import ros2_environment
from tests.support.missing import ROS2, needs

pytestmark = needs(ROS2)


class Domain:
    """Counts the creations of an endpoint that is refused while ``refuses``."""

    def __init__(self) -> None:
        from bridge.adapters.ros2.refusals import Refusals

        self.now, self.asked, self.refuses = 0.0, 0, True
        self._refusals = Refusals(lambda: self.now)

    def create(self, kind: str = "publisher") -> None:
        with self._refusals.explained(kind, "/chat", "std_msgs/msg/String"):
            self.asked += 1
            if self.refuses:
                raise ValueError("could not create data writer")


@pytest.fixture
def secured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(security, "is_enabled", lambda _environ: True)


@pytest.mark.usefixtures("secured")
def test_dds_is_not_asked_again_at_each_check() -> None:
    domain = Domain()
    for _ in range(3):
        with pytest.raises(
            MessageTypeError, match="does not accept /chat as std_msgs/msg/String: could not"
        ) as refused:
            domain.create()
        assert "the permissions of the enclave /midspan" in refused.value.cure
    assert domain.asked == 1
    with pytest.raises(MessageTypeError):
        domain.create("subscription")
    assert domain.asked == 2
    domain.now, domain.refuses = 61.0, False
    domain.create()
    domain.create()
    assert domain.asked == 4


def test_outside_of_a_secured_domain_each_check_asks() -> None:
    domain = Domain()
    for _ in range(3):
        with pytest.raises(MessageTypeError):
            domain.create()
    assert domain.asked == 3


def test_a_rejected_participant_names_the_cure(tmp_path: Path) -> None:
    """The wheels' Fast DDS rejects every enclave. In another process, as it reads its profiles only once."""
    (tmp_path / "enclaves/midspan").mkdir(parents=True)
    program = "from bridge.adapters.ros2.participant import Participant; Participant('midspan', 0)"
    env = ros2_environment(
        ROS_SECURITY_ENABLE="true", ROS_SECURITY_KEYSTORE=str(tmp_path), ROS_SECURITY_ENCLAVE_OVERRIDE="/midspan"
    )
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=False)
    reason = done.stderr.strip().splitlines()[-1]
    assert f"it rejects the files in {tmp_path}/enclaves/midspan; the log names the reason" in reason


@pytest.mark.usefixtures("secured")
def test_permissions_without_the_presence_topic_are_reported() -> None:
    from bridge.adapters.ros2.dds.fast import FastDds
    from bridge.config.model import Config

    def refuse(*_args: object) -> None:
        raise MessageTypeError("not allowed", "allow it in the permissions")

    dds = FastDds(Config())
    participant: object = SimpleNamespace(make_writer=refuse)
    with pytest.raises(RuntimeError, match=r"does not allow /_midspan/presence, .*; allow it in the permissions"):
        dds._prefix_in_use(participant)  # type: ignore[arg-type]

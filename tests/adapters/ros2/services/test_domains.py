"""Two ROS 2 networks joined by two workers and the hub: programs on each use services and actions of the other."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from bridge.adapters.ros2.environment import worker_environment
from bridge.config.model import Config
from tests.contract.side import WorkerProcess
from tests.peers.hub.quick import QuickHub
from tests.peers.peer import Peer
from tests.peers.ros2.network import new_domain, ros2_domain

ACTION = "nav2_msgs/NavigateToPose"
SECONDS = 40.0
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
MANY = 200


class Domains(NamedTuple):
    """A program on each network, and a function that starts more."""

    far: Peer
    near: Peer
    peer: Callable[..., Peer]
    far_domain: str


@pytest.fixture
def domains(peer: Callable[..., Peer], tmp_path: Path) -> Iterator[Domains]:
    far_domain = new_domain()
    with QuickHub() as hub:
        workers = [bridge(hub, number, tmp_path / str(number)) for number in (ros2_domain(), far_domain)]
        yield Domains(peer("far", ROS_DOMAIN_ID=str(far_domain)), peer("near"), peer, str(far_domain))
        for worker in workers:
            worker.stop()


def bridge(hub: QuickHub, domain: int, state: Path) -> WorkerProcess:
    config = Config.model_validate(
        {
            "name": f"domain{domain}",
            "state": str(state),
            "hub": {"listen": hub.endpoint, "domain": hub.domain},
            "ros2": {"domain": domain},
        }
    )
    return WorkerProcess("ros2", config, worker_environment(config, os.environ))


def test_services_cross_between_domains(domains: Domains) -> None:
    far, near, type_ = domains.far, domains.near, "diagnostic_msgs/AddDiagnostics"
    far.ask("serve", service="/d/echo", type=type_, echo={"message": "load_namespace"})
    near.ask("serve", service="/d/near", type="std_srvs/SetBool", reply={"message": "near"})
    requests = [{"load_namespace": str(n)} for n in range(MANY)]
    called = near.ask("call", service="/d/echo", type=type_, requests=requests, depth=MANY, seconds=SECONDS)["id"]
    back = far.ask("call", service="/d/near", type="std_srvs/SetBool", seconds=SECONDS)["id"]
    replies = near.ask("result", id=called, seconds=SECONDS)["replies"]
    assert [reply and reply["message"] for reply in replies] == [str(n) for n in range(MANY)]
    assert far.ask("result", id=back, seconds=SECONDS)["reply"]["message"] == "near"


def test_actions_cross_between_domains(domains: Domains) -> None:
    far, near = domains.far, domains.near
    feedback = [{"distance_remaining": 1.0}]
    repeated = {"times": 100, "period": 0.5}  # the first may precede the match of the client's reader
    acting = far.ask("act", action="/d/drive", type=ACTION, held=True, feedback=feedback, **repeated)["id"]
    doomed = domains.peer("doomed", ROS_DOMAIN_ID=domains.far_domain)
    doomed.ask("act", action="/d/doomed", type=ACTION, held=True)

    def send(action: str) -> int:
        return int(near.ask("send_goal", action=action, type=ACTION, seconds=SECONDS)["id"])

    def goal(number: int, **until: Any) -> None:
        result = near.ask("goal", id=number, until=until, seconds=SECONDS)
        assert {k: min(len(result[k]), until[k]) if k == "feedback" else result[k] for k in until} == until

    first, second, third = send("/d/drive"), send("/d/drive"), send("/d/doomed")
    for number in (first, second):
        goal(number, accepted=True, feedback=1)
    goal(third, accepted=True)
    near.ask("cancel", id=second)
    goal(second, status=CANCELED, cancel=[0, 1])
    far.ask("release", id=acting)
    goal(first, status=SUCCEEDED)
    doomed.signal(signal.SIGKILL)
    goal(third, status=ABORTED)

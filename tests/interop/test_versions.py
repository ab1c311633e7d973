"""An older Midspan and this one on one hub exchange topics, services and the store, and one of them is active."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.daemon.older import ROOT, STORE, WORKER, OtherStore, older_tree, python
from tests.peers.hub.quick import QuickHub
from tests.peers.zenoh.programs import Ros2ddsBridge, Router, service_texts
from tests.support.process import Process
from tests.support.rosbags_messages import Messages
from tests.support.wait import until

pytestmark = pytest.mark.thorough

STRING, SET_BOOL = "std_msgs/String", "std_srvs/SetBool"


@pytest.fixture(scope="module")
def old(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source tree of the older release."""
    return older_tree(tmp_path_factory.mktemp("older"))


class Deployment:
    """A hub, a zenoh network with a program on it, and workers of both releases between them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.ends = ExitStack()
        self.hubs = self.ends.enter_context(QuickHub())
        self.router = Router()
        self.ends.callback(self.router.stop)
        self.far = HubSide(Hub.open(self.hubs.settings("far")), Registry())
        self.ends.callback(self.far.hub.close)

    def program(self) -> Ros2ddsBridge:
        program = Ros2ddsBridge(self.router.endpoint, Messages(ros1=False, texts=service_texts()))
        self.ends.callback(program.stop)
        return program

    def config(self, name: str) -> Path:
        file = self.folder / f"{name}.yaml"
        dialect = {"router": self.router.endpoint, "dialects": [{"dialect": "ros2dds"}]}
        hub = {**self.hubs.config(), "shared_memory": False}
        file.write_text(json.dumps({"name": name, "state": str(self.folder / name), "hub": hub, "zenoh": dialect}))
        return file

    def worker(self, tree: Path, name: str) -> Process:
        texts = "worker", "zenoh", "--prepared", "--config", self.config(name)
        return self.ends.enter_context(python(tree, WORKER, *texts))

    def states(self) -> dict[str, str]:
        """Return each daemon's state, as received by this release."""
        answers = self.far.hub.ask("status", {})
        return {
            a.daemon: a.value["state"] for a in answers if isinstance(a.value, dict) and a.worker == "zenoh_ros2dds"
        }

    def midspan(self, tree: Path, *words: str) -> str:
        """Return the output of a command of the Midspan in a source tree."""
        config = self.config("looks")
        with python(tree, WORKER, *words, "--config", config) as process:
            assert process.popen.wait(60) == 0, process.output()
            return process.output()


@pytest.fixture
def deployment(tmp_path: Path) -> Iterator[Deployment]:
    deployment = Deployment(tmp_path)
    with deployment.ends:
        yield deployment


@pytest.mark.parametrize("carrier", ["old", "new"])
def test_topics_and_services_cross(deployment: Deployment, old: Path, carrier: str) -> None:
    """The worker is of one release and the command line of the other; a node of this release is on the hub."""
    tree, other = (old, ROOT) if carrier == "old" else (ROOT, old)
    deployment.worker(tree, carrier)
    far, program = deployment.far, deployment.program()
    until(lambda: deployment.states() == {carrier: "running"}, "this release understands the worker's status", 60)

    out, subscription = program.advertise("/from_side", STRING), far.subscribe("/from_side", STRING)
    far.publish_until(program, out, {"data": "in"}, lambda: far.wait(subscription, 1, 0.2))
    assert far.wait(subscription, 1)[0] == {"data": "in"}
    back, source = program.subscribe("/from_hub", STRING), far.advertise("/from_hub", STRING, latched=True)
    far.hub_publish_until(source, {"data": "out"}, lambda: program.wait(back, 1, 0.2))
    assert program.wait(back, 1)[0] == {"data": "out"}
    assert "data: out" in deployment.midspan(other, "topic", "echo", "/from_hub", "--count", "1")

    program.ask("serve", service="/of_side", type=SET_BOOL, reply={"message": "from the side"})
    answer = far.call("/of_side", SET_BOOL, data=True).result()
    assert answer["reply"] == {"success": False, "message": "from the side"}, answer
    far.serve("/of_hub", SET_BOOL, reply={"success": True, "message": "from the hub"})
    until(lambda: program.tokens("/of_hub", "SS"), "the program discovers the server", 30)

    def reported() -> bool:  # the token arrives shortly before zenoh can route to the server
        reply = program.call("/of_hub", SET_BOOL, {"data": True}).result()["reply"]
        return reply == {"success": True, "message": "from the hub"}

    until(reported, "the hub's server replies", every=0.1)
    text = deployment.midspan(other, "service", "call", "/of_side", SET_BOOL, "{data: true}")
    assert "from the side" in text
    assert re.search(rf"{carrier}.*running|running.*{carrier}", deployment.midspan(other, "status"), re.DOTALL)


@pytest.mark.parametrize("first", ["old", "new"])
def test_one_release_is_active_and_the_other_takes_over(deployment: Deployment, old: Path, first: str) -> None:
    trees = {"old": old, "new": ROOT}
    second = next(name for name in trees if name != first)
    active = deployment.worker(trees[first], first)
    until(lambda: deployment.states() == {first: "running"}, "the first worker is active", 60)
    deployment.worker(trees[second], second)
    until(lambda: deployment.states() == {first: "running", second: "standby"}, "the second worker is on standby", 60)
    far, program = deployment.far, deployment.program()
    out, subscription = program.advertise("/numbers", STRING), far.subscribe("/numbers", STRING)
    far.publish_until(program, out, {"data": "begin"}, lambda: far.wait(subscription, 1, 0.2))
    for number in range(50):
        program.publish(out, {"data": str(number)})
    until(lambda: {"data": "49"} in far.wait(subscription, 1), "the last message has arrived", 30)
    numbers = [message["data"] for message in far.wait(subscription, 1) if message["data"].isdigit()]
    assert sorted(numbers, key=int) == [str(number) for number in range(50)], "each message arrives once"
    active.stop()
    until(lambda: deployment.states() == {second: "running"}, "the second worker has taken over", 60)
    far.publish_until(program, out, {"data": "after"}, lambda: {"data": "after"} in far.wait(subscription, 1, 0.2))


def test_both_releases_share_one_store(old: Path, tmp_path: Path) -> None:
    with QuickHub() as hubs, ExitStack() as ends:
        stores: dict[str, OtherStore] = {}
        for name, tree in (("old", old), ("new", ROOT)):
            texts = tmp_path, name, hubs.endpoint, str(hubs.domain)
            process = ends.enter_context(python(tree, STORE, *texts, pipes=True))
            stores[name] = OtherStore(process)
            stores[name].ask("put", f"before {name}", 1.5)
        for name, other in (("old", "new"), ("new", "old")):
            until(
                lambda name=name, other=other: stores[name].ask("look")[1] == [other],
                "the stores discover each other",
                60,
            )
        both = {"before old": 1.5, "before new": 1.5}
        for store in stores.values():
            store.until(both)
        stores["old"].ask("put", "kitchen", 2.5)
        stores["new"].until({**both, "kitchen": 2.5})
        stores["new"].ask("put", "kitchen", 3.5)
        stores["old"].until({**both, "kitchen": 3.5})
        stores["old"].ask("delete", "before new")
        stores["new"].ask("delete", "before old")
        for store in stores.values():
            store.until({"kitchen": 3.5})
            assert store.ask("look")[2] == 0, "the stores had conflicting changes"


def test_the_older_release_announces_no_version(old: Path) -> None:
    """If it announced one, these tests would not show differences between releases."""
    result = subprocess.run(["grep", "-rl", "hub.wire.version", old / "bridge"], capture_output=True, check=False)
    assert result.stdout == b""

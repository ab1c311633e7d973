"""The examples in package docstrings run as written."""

from __future__ import annotations

import builtins
import importlib
import inspect
import json
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import bridge.client
import bridge.hub
import bridge.modules
import yarp_compat
from bridge.client.session import connect
from bridge.config.load import load
from bridge.config.model import Config
from bridge.messages.registry import Registry
from bridge.modules.host import Host
from tests.peers.hub.quick import QuickHub
from tests.peers.yarp.network import network_of
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.server import NameServer

BOOL = "std_msgs/msg/Bool"
REGISTRY = Registry()


def example(package: ModuleType) -> str:
    """Return the code in a package's docstring: the indented lines below a line that ends in two colons."""
    lines = (inspect.getdoc(package) or "").splitlines()
    start = next(number for number, line in enumerate(lines) if line.endswith("::")) + 1
    end = next((number for number, line in enumerate(lines) if number > start and line[:1].strip()), len(lines))
    return textwrap.dedent("\n".join(lines[start:end]))


def run(code: str, names: dict[str, Any] | None = None) -> dict[str, Any]:
    """Run an example in a new module, with these names so far; return its names."""
    names = {} if names is None else names
    names["__name__"] = "example"
    exec(compile(code, "example", "exec"), names)
    return names


@pytest.fixture(scope="module")
def hubs() -> Iterator[QuickHub]:
    network = QuickHub()
    yield network
    network.stop_router()


@pytest.fixture
def host(hubs: QuickHub, tmp_path: Path) -> Iterator[Host]:
    config = {"name": "robot1", "state": str(tmp_path), "hub": hubs.config(), "yarp": {"enabled": False}}
    module_host = Host("lamp", Config.model_validate(config), REGISTRY)
    module_host.loop.start()
    module_host.answer("status", lambda _: {"state": "running"})
    yield module_host
    module_host.close()


def test_a_program_calls_the_service_of_a_module(
    hubs: QuickHub, host: Host, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    received: list[dict[str, Any]] = []
    host.node.subscription("/lamp/state", BOOL, received.append)
    lamp = run(example(bridge.modules))["Lamp"]()
    host.loop.call(lambda: lamp.start(host, None))
    file = tmp_path / "midspan.yaml"
    file.write_text(json.dumps({"hub": hubs.config()}))
    monkeypatch.setenv("MIDSPAN_CONFIG", str(file))
    with connect(load()) as client:
        until(lambda: client.ask("status", worker="lamp"), "the router knows the module")
    run(example(bridge.client))
    assert capsys.readouterr().out == "lamp running\n{'success': True, 'message': ''}\n"


def test_a_node_publishes_on_the_hub(hubs: QuickHub, host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[dict[str, Any]] = []
    host.node.subscription("/lamp/on", BOOL, received.append)
    names: dict[str, Any] = {}
    monkeypatch.setattr(
        builtins, "input", lambda _: until(lambda: names["publisher"].matched(), "the publisher has a subscriber")
    )
    code = example(bridge.hub)
    endpoint = "tcp/127.0.0.1:7447"
    assert endpoint in code
    run(code.replace(endpoint, hubs.endpoint), names)
    assert until(lambda: received, "the message has arrived") == [{"data": True}]


def test_ports_exchange_a_bottle(capsys: pytest.CaptureFixture[str]) -> None:
    with NameServer(port=free_port()) as server, network_of(NameClient(server.address)):
        run(example(yarp_compat))
    assert capsys.readouterr().out == "hello 3.5\n"


@pytest.mark.parametrize("package", [bridge.client, bridge.hub, bridge.modules, yarp_compat], ids=lambda p: p.__name__)
def test_examples_are_short(package: ModuleType) -> None:
    assert 5 <= len([line for line in example(package).splitlines() if line.strip()]) <= 11


def test_the_client_library_page_lists_the_files_and_shows_the_example() -> None:
    root = Path(__file__).parents[2]
    page = (root / "docs" / "develop" / "client_library.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)\.py` \| (.*)", page, re.MULTILINE))
    files = {path.stem for path in (root / "bridge" / "client").glob("*.py")}
    assert files - rows.keys() == {"__init__", "errors", "authorities"}
    for file, text in rows.items():
        for name in re.findall(r"`([A-Za-z]\w+)", text):
            assert hasattr(importlib.import_module(f"bridge.client.{file}"), name), name
    assert example(bridge.client).strip() in page

"""Addresses in one configuration that cannot all be opened."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from pathlib import Path

import pytest

from bridge.config.document import ConfigError
from bridge.config.listeners import Listener
from bridge.config.load import loads


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "web: {enabled: true, listen: '127.0.0.1:7447'}",
            "1:30: web.listen: 127.0.0.1:7447 uses the same port as hub.listen (tcp/127.0.0.1:7447)",
        ),
        (
            "hub: {listen: 'tcp/127.0.0.1:8480'}\nweb: {enabled: true}",
            "1:15: hub.listen: tcp/127.0.0.1:8480 uses the same port as web.listen (127.0.0.1:8480)",
        ),
        (
            "web: {enabled: true, listen: '127.0.0.1:9480'}\nmetrics: {enabled: true}",
            "1:30: web.listen: 127.0.0.1:9480 uses the same port as metrics.listen (127.0.0.1:9480)",
        ),
        (
            "web: {enabled: true}\nfoxglove: {enabled: true, listen: 'localhost:8480'}",
            "2:35: foxglove.listen: localhost:8480 uses the same port as web.listen (127.0.0.1:8480)",
        ),
        (
            "hub: {open: {listen: ['tls/0.0.0.0:7448', 'tls/192.168.1.5:7448']}}",
            (
                "1:43: hub.open.listen[1]: tls/192.168.1.5:7448 uses the same port as hub.open.listen[0]"
                " (tls/0.0.0.0:7448)"
            ),
        ),
        (
            "hub: {open: {listen: 'tls/[::]:8765'}}\nfoxglove: {enabled: true}",
            "1:22: hub.open.listen[0]: tls/[::]:8765 uses the same port as foxglove.listen (127.0.0.1:8765)",
        ),
        (
            "web: {enabled: true, listen: '127.0.0.1:10000'}\nyarp: {nameserver: embedded, address: 'localhost:10000'}",
            "2:39: yarp.address: localhost:10000 uses the same port as web.listen (127.0.0.1:10000)",
        ),
    ],
)
def test_two_listeners_on_the_same_port_are_a_problem(text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        loads(text, Path("a.yaml"))
    (result,) = caught.value.problems
    assert str(result) == f"a.yaml:{problem}; change one of the ports"


@pytest.mark.parametrize(
    "text",
    [
        "web: {enabled: false, listen: '127.0.0.1:7447'}",
        "web: {enabled: true, listen: '127.0.0.2:7447'}",
        "web: {enabled: true, listen: '[::1]:7447'}",
        "web: {enabled: true, listen: '127.0.0.1:0'}\nmetrics: {enabled: true, listen: '127.0.0.1:0'}",
        "hub: {open: {listen: ['tls/0.0.0.0:7448', 'quic/0.0.0.0:7448']}}",
        "web: {enabled: true, listen: '127.0.0.1:10000'}\nyarp: {nameserver: site, address: 'localhost:10000'}",
    ],
)
def test_listeners_that_can_all_be_opened_are_accepted(text: str) -> None:
    assert loads(text).name


@pytest.mark.parametrize("other", ["127.0.0.1", "127.0.0.2", "0.0.0.0", "::1", "::"])
@pytest.mark.parametrize("one", ["127.0.0.1", "0.0.0.0", "::"])
def test_the_system_refuses_the_same_pairs_of_listeners(one: str, other: str) -> None:
    with ExitStack() as stack:
        first, second = (
            stack.enter_context(socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET))
            for host in (one, other)
        )
        first.bind((one, 0))
        first.listen()
        port = first.getsockname()[1]
        try:
            second.bind((other, port))
            second.listen()
            opened = True
        except OSError:
            opened = False
    assert Listener(("a",), "", one, port).excludes(Listener(("b",), "", other, port)) is not opened

"""Transcripts of four releases, replayed by clients of one server."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from typing import Any

from tests.yarp_compat.dev.interfaces import All
from tests.yarp_compat.dev.release_clients import (
    Client,
    connect,
    loads,
)
from tests.yarp_compat.dev.test_transcripts import exchanges, parse_request
from tests.yarp_compat.ports.conftest import make_port, naming
from yarp_compat.dev.server import Server
from yarp_compat.wire import framing
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile

__all__ = ["connect", "loads", "make_port", "naming"]

Talk = list[tuple[bytes, bytes]]


def recorded() -> dict[str, Talk]:
    """Return requests and replies of four releases.

    Those of 3.12.3 and 4.0 were recorded. Requests of 3.6 and 3.9 equal 3.12's (captured with 3.9.1; for these calls,
    v3.6.0 and v3.9.1 have the same interfaces and writers), and their replies have a boolean as outcome.
    """
    older = []
    for request, reply in exchanges("nav-3.12.3.txt"):
        _, call, _ = parse_request(request, Profile.YARP3)
        assert call is not None
        results = call.read_reply(reply, Generation.YARP_3_12).results
        older.append((request, call.reply(results, Generation.YARP_3_6)))
    newer = [(request, reply) for name in ("nav-3.12.3.txt", "nav-4.0.txt") for request, reply in exchanges(name)]
    split = len(older)
    return {"3.6": older, "3.9": older, "3.12": newer[:split], "4.0": newer[split:]}


class Replaying(All):
    """A server whose methods return the recorded results of the client's release, which the thread's name gives."""

    def __init__(self, talks: dict[str, Talk]) -> None:
        super().__init__()
        self.results: dict[str, list[list[Any]]] = {}
        for release, talk in talks.items():
            generation = Generation.of(release)
            for request, reply in talk:
                _, call, _ = parse_request(request, generation.profile)
                if call is not None:
                    self.results.setdefault(release, []).append(call.read_reply(reply, generation).results)

    def __getattribute__(self, name: str) -> Any:
        if name.endswith("RPC"):
            return lambda *_: self.next_results()
        return super().__getattribute__(name)

    def next_results(self) -> Any:
        release = threading.current_thread().name.split()[1].removeprefix("/nav")
        results = self.results[release].pop(0)
        return results[0] if len(results) == 1 else tuple(results)


def test_transcripts_of_four_releases_are_reproduced_at_one_server(connect: Callable[..., Client]) -> None:
    """The clients take turns; each reply equals that of the real server byte for byte."""
    talks = recorded()
    rules = [(f"/nav{release}", Generation.of(release)) for release in ("3.6", "3.9", "3.12")]
    replaying = Replaying(talks)
    server = Server(replaying, Generations(None, rules))
    clients = {release: connect(server, f"/nav{release}", release) for release in talks}
    for requests in itertools.zip_longest(*([(release, *pair) for pair in talk] for release, talk in talks.items())):
        sent = [request for request in requests if request is not None]
        for release, request, _ in sent:
            clients[release].send(request)
        for release, _, reply in sent:
            assert clients[release].receive(len(reply) + 8) == reply + framing.ACK, release
    assert not any(replaying.results.values())


def test_transcripts_of_four_unknown_releases_contain_no_false_success(connect: Callable[..., Client]) -> None:
    """Clients of 3.12 and 4.0 read the real outcome. Older clients do so only if it is the whole reply.

    Otherwise they read a failure.
    """
    talks = recorded()
    server = Server(Replaying(talks), Generations())
    clients = {release: connect(server, f"/nav{release}", release) for release in talks}
    for requests in itertools.zip_longest(*([(release, *pair) for pair in talk] for release, talk in talks.items())):
        for recorded_call in requests:
            if recorded_call is None:
                continue
            release, request, reply = recorded_call
            generation, client = Generation.of(release), clients[release]
            _, call, _ = parse_request(request, generation.profile)
            client.send(request)
            if call is None:
                assert client.receive(len(reply) + 8) == reply + framing.ACK
                continue
            succeeded = bool(call.read_reply(reply, generation).results[0])
            success = client.read(call)
            assert client.in_step
            if release in ("3.12", "4.0") or call.single:
                assert success is succeeded, (release, call.name)
            else:
                assert not success

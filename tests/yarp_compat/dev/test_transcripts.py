"""Transcripts of real YARP programs: each request and reply is decoded and encoded to the same bytes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import pytest

from tests.yarp_compat.dev.interfaces import All, Tree
from tests.yarp_compat.transcripts import read
from yarp_compat.dev.server import Server
from yarp_compat.dev.service import INTRODUCTION, Call, read_version, version_end, write_version
from yarp_compat.wire import framing
from yarp_compat.wire.errors import Incomplete
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile

ACK = bytes.fromhex("5941000000005250")
INDEX = bytes.fromhex("59410a0000005250")
RECORDED = {"nav-3.12.3.txt": Generation.YARP_3_12, "nav-4.0.txt": Generation.YARP_4,
            "frame-transform.txt": Generation.YARP_4}  # fmt: skip


def exchanges(name: str) -> Iterator[tuple[bytes, bytes]]:
    """Yield requests with their replies."""
    for talk in read(name):
        for request, reply in zip(talk.steps, talk.steps[1:], strict=False):
            if request.by == "C" and reply.by == "S" and request.data.startswith(INDEX):
                command, payload = framing.parse(request.data)
                if command.key == "d":
                    assert reply.data.endswith(ACK)
                    yield bytes(payload), reply.data[: -len(ACK)]


def streamed(name: str) -> Iterator[bytes]:
    for talk in read(name):
        for step in talk.steps:
            if step.by == "C" and step.data.startswith(INDEX):
                command, payload = framing.parse(step.data)
                if command.key == "D":
                    yield bytes(payload)


def parse_request(payload: bytes, profile: Profile) -> tuple[str, Call | None, list[Any]]:
    name, call, arguments, dialect = Server(All()).parse_request(payload, profile)
    assert dialect is profile
    return name, call, arguments


@pytest.mark.parametrize(("name", "count"), [("nav-3.12.3.txt", 16), ("nav-4.0.txt", 60), ("frame-transform.txt", 4)])
def test_every_recorded_exchange_is_reproduced(name: str, count: int) -> None:
    generation, seen = RECORDED[name], 0
    for request, reply in exchanges(name):
        method, call, arguments = parse_request(request, generation.profile)
        seen += 1
        if call is None:
            assert method == INTRODUCTION
            assert read_version(reply) == (0, 4, 0, 0)
            assert write_version(0) == reply
            continue
        assert call.request(arguments, generation.profile) == request
        parsed = call.read_reply(reply, generation)
        assert (parsed.size, parsed.generation) == (len(reply), generation)
        assert call.reply(parsed.results, generation) == reply
    assert seen >= count


@pytest.mark.parametrize("name", RECORDED)
def test_an_incomplete_reply_is_recognized(name: str) -> None:
    for request, reply in exchanges(name):
        _, call, _ = parse_request(request, RECORDED[name].profile)
        for size in range(len(reply)):
            with pytest.raises(Incomplete):
                version_end(reply[:size]) if call is None else call.read_reply(reply[:size], RECORDED[name])
        end = version_end(reply + ACK) if call is None else call.read_reply(reply + ACK, RECORDED[name]).size
        assert end == len(reply)


def test_a_reply_shows_its_generation_to_a_client_that_expects_another() -> None:
    for name, generation in RECORDED.items():
        for request, reply in exchanges(name):
            _, call, _ = parse_request(request, generation.profile)
            if call is not None and not call.single:
                assert call.read_reply(reply, Generation.YARP_3_6).generation is generation


def test_the_recorded_stream_of_transforms_is_reproduced() -> None:
    sizes = set()
    for payload in streamed("frame-transform.txt"):
        tree = Tree.from_bytes(payload, Profile.YARP4)
        assert tree.retvalue
        assert tree.to_bytes(Profile.YARP4) == payload
        sizes.add(len(tree.transforms))
    assert sizes == {0, 1, 2}
    assert tree.transforms[0].src_frame_id


def test_a_server_of_3_12_returns_stored_locations() -> None:
    calls = [
        (call.name, call.read_reply(reply, Generation.YARP_3_12).results)
        for request, reply in exchanges("nav-3.12.3.txt")
        if (call := parse_request(request, Profile.YARP3)[1]) is not None
    ]
    stored = [results for name, results in calls if name == "get_location_RPC"]
    assert [bool(results[0]) for results in stored] == [True, False, True]
    assert dataclasses.astuple(stored[0][1]) == ("m1", 1.0, 2.0, 90.0, "kd")
    assert dataclasses.astuple(stored[1][1]) == ("", 0.0, 0.0, 0.0, "")


class Replayed(All):
    """A server whose methods return the results of the real server."""

    def __init__(self, results: dict[str, list[Any]]) -> None:
        super().__init__()
        self.results = results

    def __getattribute__(self, name: str) -> Any:
        if name.endswith("RPC") and not name.startswith("_"):
            return lambda *_: self.next_results(name)
        return super().__getattribute__(name)

    def next_results(self, name: str) -> Any:
        results = self.results[name].pop(0)
        return results[0] if len(results) == 1 else tuple(results)


@pytest.mark.parametrize("name", RECORDED)
@pytest.mark.parametrize("default", [Generation.YARP_3_12, Generation.YARP_4])
def test_our_server_replies_like_the_real_one(name: str, default: Generation) -> None:
    """With any default generation: clients of 4.0 introduce themselves, those of 3.12 match a rule."""
    generation = RECORDED[name]
    recorded: dict[str, list[Any]] = {}
    for request, reply in exchanges(name):
        _, call, _ = parse_request(request, generation.profile)
        if call is not None:
            recorded.setdefault(call.name, []).append(call.read_reply(reply, generation).results)
    server = Server(Replayed(recorded), Generations(default, [("/cli3/*", Generation.YARP_3_12)]))
    if name == "nav-3.12.3.txt":
        peer = "/cli3/rpc"
    else:
        peer = "/cli/rpc"
        server.answer(next(request for request, _ in exchanges(name)), peer)
    for request, reply in exchanges(name):
        assert server.answer(request, peer) == reply

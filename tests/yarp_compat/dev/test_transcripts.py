"""Each request and reply that real YARP programs exchanged, read and written again to the same bytes."""

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
    """Requests with their replies."""
    for talk in read(name):
        for asked, told in zip(talk.steps, talk.steps[1:], strict=False):
            if asked.by == "C" and told.by == "S" and asked.data.startswith(INDEX):
                command, payload = framing.parse(asked.data)
                if command.key == "d":
                    assert told.data.endswith(ACK)
                    yield bytes(payload), told.data[: -len(ACK)]


def streamed(name: str) -> Iterator[bytes]:
    for talk in read(name):
        for step in talk.steps:
            if step.by == "C" and step.data.startswith(INDEX):
                command, payload = framing.parse(step.data)
                if command.key == "D":
                    yield bytes(payload)


def taken(payload: bytes, profile: Profile) -> tuple[str, Call | None, list[Any]]:
    name, call, arguments, found = Server(All()).taken(payload, profile)
    assert found is profile
    return name, call, arguments


@pytest.mark.parametrize(("name", "count"), [("nav-3.12.3.txt", 16), ("nav-4.0.txt", 60), ("frame-transform.txt", 4)])
def test_every_exchange(name: str, count: int) -> None:
    generation, seen = RECORDED[name], 0
    for request, reply in exchanges(name):
        method, call, arguments = taken(request, generation.profile)
        seen += 1
        if call is None:
            assert method == INTRODUCTION
            assert read_version(reply) == (0, 4, 0, 0)
            assert write_version(0) == reply
            continue
        assert call.request(arguments, generation.profile) == request
        found = call.read_reply(reply, generation)
        assert (found.size, found.generation) == (len(reply), generation)
        assert call.reply(found.results, generation) == reply
    assert seen >= count


@pytest.mark.parametrize("name", RECORDED)
def test_a_reply_in_pieces_is_told_from_a_whole_one(name: str) -> None:
    for request, reply in exchanges(name):
        _, call, _ = taken(request, RECORDED[name].profile)
        for size in range(len(reply)):
            with pytest.raises(Incomplete):
                version_end(reply[:size]) if call is None else call.read_reply(reply[:size], RECORDED[name])
        end = version_end(reply + ACK) if call is None else call.read_reply(reply + ACK, RECORDED[name]).size
        assert end == len(reply)


def test_the_reply_tells_its_generation_to_a_client_that_expects_another() -> None:
    for name, generation in RECORDED.items():
        for request, reply in exchanges(name):
            _, call, _ = taken(request, generation.profile)
            if call is not None and not call.alone:
                assert call.read_reply(reply, Generation.YARP_3_6).generation is generation


def test_the_stream_of_transforms() -> None:
    sizes = set()
    for payload in streamed("frame-transform.txt"):
        tree = Tree.from_bytes(payload, Profile.YARP4)
        assert tree.retvalue
        assert tree.to_bytes(Profile.YARP4) == payload
        sizes.add(len(tree.transforms))
    assert sizes == {0, 1, 2}
    assert tree.transforms[0].src_frame_id


def test_locations_of_a_3_12_server_are_what_was_stored() -> None:
    found = [
        (call.name, call.read_reply(reply, Generation.YARP_3_12).results)
        for request, reply in exchanges("nav-3.12.3.txt")
        if (call := taken(request, Profile.YARP3)[1]) is not None
    ]
    stored = [results for name, results in found if name == "get_location_RPC"]
    assert [bool(results[0]) for results in stored] == [True, False, True]
    assert dataclasses.astuple(stored[0][1]) == ("m1", 1.0, 2.0, 90.0, "kd")
    assert dataclasses.astuple(stored[1][1]) == ("", 0.0, 0.0, 0.0, "")


class Replayed(All):
    """A server whose every method returns what the real one did."""

    def __init__(self, results: dict[str, list[Any]]) -> None:
        super().__init__()
        self.results = results

    def __getattribute__(self, name: str) -> Any:
        if name.endswith("RPC") and not name.startswith("_"):
            return lambda *_: self.said(name)
        return super().__getattribute__(name)

    def said(self, name: str) -> Any:
        results = self.results[name].pop(0)
        return results[0] if len(results) == 1 else tuple(results)


@pytest.mark.parametrize("name", RECORDED)
@pytest.mark.parametrize("default", [Generation.YARP_3_12, Generation.YARP_4])
def test_a_server_of_ours_answers_as_the_real_one_did(name: str, default: Generation) -> None:
    """Whatever the name server's generation is: 4.0's clients introduce themselves, 3.12's are named by a rule."""
    generation = RECORDED[name]
    said: dict[str, list[Any]] = {}
    for request, reply in exchanges(name):
        _, call, _ = taken(request, generation.profile)
        if call is not None:
            said.setdefault(call.name, []).append(call.read_reply(reply, generation).results)
    server = Server(Replayed(said), Generations(default, [("/cli3/*", Generation.YARP_3_12)]))
    if name == "nav-3.12.3.txt":
        peer = "/cli3/rpc"
    else:
        peer = "/cli/rpc"
        server.answer(next(request for request, _ in exchanges(name)), peer)
    for request, reply in exchanges(name):
        assert server.answer(request, peer) == reply

"""Transcripts of YARP 3.12.3's and 4.0's client and server with a ``fakeMotionControl``, reproduced byte for byte.

Recorded by a program that calls most methods of a board, see `docs/yarp/boards.md`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from tests.yarp_compat.dev.test_transcripts import ACK, INDEX
from tests.yarp_compat.transcripts import read
from yarp_compat.dev.controlboard import vocab_rpc
from yarp_compat.dev.controlboard.board import JointBoard
from yarp_compat.dev.controlboard.messages import ControlBoardMsgs
from yarp_compat.dev.controlboard.server import BoardHandler
from yarp_compat.dev.controlboard.streams import CommandMessage, JointData, command, parse_command
from yarp_compat.dev.returnvalue import OK
from yarp_compat.dev.server import Server
from yarp_compat.dev.service import INTRODUCTION
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import DEFAULT_LIMIT, HEAD_SIZE, body_size, index_size, parse
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile

FILES = {Profile.YARP3: "controlboard-3.12.3.txt", Profile.YARP4: "controlboard-4.0.txt"}
LINK = ("127.0.0.1", 40000)


def exchanges(profile: Profile) -> Iterator[tuple[bytes, bytes]]:
    """Yield requests with their replies."""
    for talk in read(FILES[profile]):
        for request, reply in zip(talk.steps, talk.steps[1:], strict=False):
            if request.by == "C" and reply.by == "S" and request.data.startswith(INDEX):
                command, payload = parse(request.data)
                if command.key == "d":
                    yield bytes(payload), reply.data.removesuffix(ACK)


def streamed(profile: Profile) -> Iterator[bytes]:
    """Yield messages without a reply; the last one of a connection is left out if it is incomplete."""
    for talk in read(FILES[profile]):
        data = talk.sent_by("C")
        data = data[12 + int.from_bytes(data[8:12], "little") :]
        while len(data) > HEAD_SIZE and len(data) >= (size := index_size(data)):
            size += body_size(data, 0, DEFAULT_LIMIT)
            if len(data) < size:
                break
            command, payload = parse(data[:size])
            data = data[size:]
            if command.key == "D":
                yield bytes(payload)


def board_of(method: str, arguments: list[Any], results: tuple[Any, ...]) -> JointBoard:
    """Return a board of three joints that expects the recorded call and returns the recorded results."""

    def call(_self: object, *given: Any) -> Any:
        assert [str(value) for value in given] == [str(value) for value in arguments]
        return results if len(ControlBoardMsgs.calls()[method].results) > 1 else results[0]

    kind: type[JointBoard] = type("Replayed", (JointBoard,), {method: call})
    return kind(3)


def test_every_recorded_exchange_of_3_12_is_reproduced() -> None:
    seen = set()
    for request, reply in exchanges(Profile.YARP3):
        bottle, answer = decode(request, Profile.YARP3), decode(reply, Profile.YARP3)
        if bottle[:2] == ["get", "prot"]:
            assert BoardHandler(JointBoard(3)).respond(bottle) == answer
            continue
        methods, vocabs = vocab_rpc.methods_by_vocabs(), tuple(map(str, bottle[:3]))
        call, form = methods.get(vocabs) or methods[vocabs[:2]]
        arguments = bottle[len(form.request) + ("Group" in call.name) :]
        given = [
            vocab_rpc.read_value(field, value) for (_, field), value in zip(call.arguments, arguments, strict=False)
        ]
        if "setRemoteVariable" not in call.name:  # its value extends to the end of the request
            assert encode(vocab_rpc.request(call.name, given), Profile.YARP3) == request
        outcome, *results = vocab_rpc.results(call.name, answer)
        stamp = (0, 0.0)
        if "tsta" in answer:
            stamp = (answer[answer.index("tsta") + 1], answer[answer.index("tsta") + 2])
        if outcome:
            board = board_of(call.name, given, (OK, *results))
            assert encode(vocab_rpc.respond(board, bottle, stamp), Profile.YARP3) == reply, call.name
        else:
            assert encode(vocab_rpc.respond(JointBoard(3), bottle, stamp), Profile.YARP3) == reply
        seen.add(call.name)
    assert len(seen) >= 55


@pytest.mark.parametrize("request_of", [["cmod", math.inf], ["cmog", 1, [math.inf]], ["cmod"], ["cmod", "x"]])
def test_request_with_an_invalid_joint_fails(request_of: list[Any]) -> None:
    assert vocab_rpc.respond(JointBoard(3), ["get", "icmd", *request_of], (0, 0.0)) == ["fail"]


def test_every_recorded_exchange_of_4_0_is_reproduced() -> None:
    seen = set()
    for request, reply in exchanges(Profile.YARP4):
        name, call, arguments, dialect = Server(BoardHandler(JointBoard(3)).service).parse_request(
            request, Profile.YARP4
        )
        if name == INTRODUCTION:
            continue
        assert call is not None
        assert dialect is Profile.YARP4
        assert call.request(arguments, Profile.YARP4) == request
        parsed = call.read_reply(reply, Generation.YARP_4)
        assert (parsed.size, parsed.generation) == (len(reply), Generation.YARP_4)
        if name == "getDeviceInterfacesRPC":
            assert parsed.results[1]["iPositionControl"] is True
            assert parsed.results[1]["iRemoteVariables"] is False
            assert call.reply(parsed.results, Generation.YARP_4) != b""
        elif parsed.results[0]:
            service = BoardHandler(board_of(name, arguments, tuple(parsed.results))).service
            server = Server(service, Generations(Generation.YARP_4))
            assert server.answer(request, "/client", Profile.YARP4, LINK) == reply
        seen.add(name)
    assert len(seen) >= 55


@pytest.mark.parametrize("profile", FILES)
def test_every_recorded_command_and_state_is_reproduced(profile: Profile) -> None:
    methods, states = set(), 0
    for payload in streamed(profile):
        try:
            state = JointData.from_bytes(payload, profile)
        except WireError:
            message = CommandMessage.from_bytes(payload, profile)
            method, arguments = parse_command(message)
            assert command(method, arguments, profile).to_bytes(profile) == payload
            methods.add(method)
        else:
            assert state.axes == 3
            assert {"jointPosition", "controlMode"} <= set(state.values)
            assert ("temperature" in state.values) is (profile is Profile.YARP4)
            assert state.to_bytes(profile) == payload
            states += 1
    assert states
    assert {"velocityMoveOneRPC", "velocityMoveGroupRPC", "velocityMoveAllRPC", "setRefPositionGroupRPC"} <= methods
    assert {"setRefTorqueOneRPC", "setRefTorqueAllRPC"} <= methods

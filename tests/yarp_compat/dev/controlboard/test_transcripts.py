"""What YARP 3.12.3's and 4.0's client and server said of a ``fakeMotionControl``, read and written to the same bytes.

Recorded by a program that calls most methods of a board, see `docs/yarp/boards.md`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.yarp_compat.dev.test_transcripts import ACK, INDEX
from tests.yarp_compat.transcripts import read
from yarp_compat.dev.controlboard import words
from yarp_compat.dev.controlboard.board import JointBoard
from yarp_compat.dev.controlboard.messages import ControlBoardMsgs
from yarp_compat.dev.controlboard.server import BoardAnswers
from yarp_compat.dev.controlboard.streams import CommandMessage, JointData, called, command
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
    """Requests with their replies."""
    for talk in read(FILES[profile]):
        for asked, told in zip(talk.steps, talk.steps[1:], strict=False):
            if asked.by == "C" and told.by == "S" and asked.data.startswith(INDEX):
                command, payload = parse(asked.data)
                if command.key == "d":
                    yield bytes(payload), told.data.removesuffix(ACK)


def streamed(profile: Profile) -> Iterator[bytes]:
    """Messages that nobody answers; the last one of a connection may not be whole."""
    for talk in read(FILES[profile]):
        data = talk.said("C")
        data = data[12 + int.from_bytes(data[8:12], "little") :]
        while len(data) > HEAD_SIZE and len(data) >= (size := index_size(data)):
            size += body_size(data, 0, DEFAULT_LIMIT)
            if len(data) < size:
                break
            word, payload = parse(data[:size])
            data = data[size:]
            if word.key == "D":
                yield bytes(payload)


def board_of(method: str, arguments: list[Any], results: tuple[Any, ...]) -> JointBoard:
    """A board of three joints that was asked what the real one was asked, and does as that did."""

    def call(_self: object, *given: Any) -> Any:
        assert [str(value) for value in given] == [str(value) for value in arguments]
        return results if len(ControlBoardMsgs.calls()[method].results) > 1 else results[0]

    kind: type[JointBoard] = type("Replayed", (JointBoard,), {method: call})
    return kind(3)


def test_each_exchange_with_a_board_of_3_12() -> None:
    seen = set()
    for request, reply in exchanges(Profile.YARP3):
        asked, said = decode(request, Profile.YARP3), decode(reply, Profile.YARP3)
        if asked[:2] == ["get", "prot"]:
            assert BoardAnswers(JointBoard(3)).respond(asked) == said
            continue
        call, pattern = words.known().get(tuple(map(str, asked[:3]))) or words.known()[tuple(map(str, asked[:2]))]
        arguments = asked[len(pattern.request) + ("Group" in call.name) :]
        given = [words.read_value(field, value) for (_, field), value in zip(call.arguments, arguments, strict=False)]
        if "setRemoteVariable" not in call.name:  # whose value goes on to the end
            assert encode(words.request(call.name, given), Profile.YARP3) == request
        outcome, *found = words.results(call.name, said)
        stamp = (said[said.index("tsta") + 1], said[said.index("tsta") + 2]) if "tsta" in said else (0, 0.0)
        if outcome:
            board = board_of(call.name, given, (OK, *found))
            assert encode(words.respond(board, asked, stamp), Profile.YARP3) == reply, call.name
        else:
            assert encode(words.respond(JointBoard(3), asked, stamp), Profile.YARP3) == reply
        seen.add(call.name)
    assert len(seen) >= 55


def test_each_exchange_with_a_board_of_4_0() -> None:
    seen = set()
    for request, reply in exchanges(Profile.YARP4):
        name, call, arguments, found = Server(BoardAnswers(JointBoard(3)).service).taken(request, Profile.YARP4)
        if name == INTRODUCTION:
            continue
        assert call is not None
        assert found is Profile.YARP4
        assert call.request(arguments, Profile.YARP4) == request
        told = call.read_reply(reply, Generation.YARP_4)
        assert (told.size, told.generation) == (len(reply), Generation.YARP_4)
        if name == "getDeviceInterfacesRPC":
            assert told.results[1]["iPositionControl"] is True
            assert told.results[1]["iRemoteVariables"] is False
            assert call.reply(told.results, Generation.YARP_4) != b""
        elif told.results[0]:
            service = BoardAnswers(board_of(name, arguments, tuple(told.results))).service
            server = Server(service, Generations(Generation.YARP_4))
            assert server.answer(request, "/client", Profile.YARP4, LINK) == reply
        seen.add(name)
    assert len(seen) >= 55


@pytest.mark.parametrize("profile", FILES)
def test_each_command_and_state(profile: Profile) -> None:
    methods, states = set(), 0
    for payload in streamed(profile):
        try:
            state = JointData.from_bytes(payload, profile)
        except WireError:
            message = CommandMessage.from_bytes(payload, profile)
            method, arguments = called(message)
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

"""A board's methods as Bottles of vocabs, as releases 3.x of YARP ask them at ``/rpc:i`` (`RPCMessagesParser.cpp`).

``[get] [enc] 0`` is answered ``[is] [enc] 12.5 [tsta] 7 1795143618.02 [ok]``, what fails ``[fail]``. Lists of joints
have their length before them: ``[set] [posg] 2 (0 1) (10.0 20.0)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from yarp_compat.dev.controlboard.board import JointBoard, answer
from yarp_compat.dev.controlboard.messages import MODE, TRUNCATED, ControlBoardMsgs, Words
from yarp_compat.dev.fields import BOOLEAN, FLOAT64, TEXT, FieldCodec, Integer, ListOf, Nested
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.service import Call
from yarp_compat.os.data.bottle import Bottle
from yarp_compat.os.data.vocab import Vocab32
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.values import Vocab, vocab32

PROTOCOL = (1, 9, 0)
"""What ``[get] [prot]`` is answered since 2.3.70; clients of 3.x refuse another first or second number."""

_FAILED = ReturnValue(ReturnCode.METHOD_FAILED)


@cache
def known() -> dict[tuple[str, ...], tuple[Call, Words]]:
    """The methods by the vocabs that ask for them."""
    found = {}
    for name, call in ControlBoardMsgs.calls().items():
        said = words_of(name)
        if said is not None:
            found[said.request] = (call, said)
    return found


def words_of(method: str) -> Words | None:
    """How 3.x asks for a method; None where it cannot."""
    said: Words | None = getattr(getattr(ControlBoardMsgs, method), "words", None)
    return said


def request(method: str, arguments: Sequence[Any]) -> list[Any]:
    """The Bottle that asks for a method; raises `WireError` where 3.x cannot, or an argument is wrong."""
    call, said = ControlBoardMsgs.calls()[method], words_of(method)
    if said is None:
        raise WireError(f"a control board of YARP 3 does not answer {method}")
    asked: list[Any] = list(map(Vocab, said.request))
    if _counted(method):
        asked.append(len(arguments[0]))
    for (name, field), value in zip(call.arguments, arguments, strict=True):
        try:
            written = _written(field, value)
        except (TypeError, ValueError, OverflowError) as error:
            raise WireError(f"{method}, {name}: {error}") from None
        if isinstance(value, Bottle):
            asked += written
        else:
            asked.append(written)
    return asked


def results(method: str, said: Sequence[Any]) -> tuple[Any, ...]:
    """The outcome, and the results where it is ok; raises `WireError` for what is no answer to this method."""
    call, pattern = ControlBoardMsgs.calls()[method], words_of(method)
    assert pattern is not None
    if not said or said[-1] != "ok":
        return (_FAILED,)
    fields = call.results[1:]
    if "*" not in pattern.reply:
        return (OK,)
    first = pattern.reply.index("*")
    if len(said) < first + len(fields) + 1:
        raise WireError(f"{method} returns {len(fields)} values, and the reply is {list(said)}")
    return OK, *(read_value(field, value) for field, value in zip(fields, said[first:], strict=False))


def respond(board: JointBoard, asked: Sequence[Any], stamp: tuple[int, float]) -> list[Any]:
    """A board's answer to a Bottle; ``stamp``, a number and seconds, is that of answers with one."""
    try:
        return _answer(board, asked, stamp)
    except (WireError, CallFailed, NotImplementedError, IndexError, TypeError, ValueError):
        return [Vocab("fail")]


def _answer(board: JointBoard, asked: Sequence[Any], stamp: tuple[int, float]) -> list[Any]:
    vocabs = tuple(str(value) for value in asked[:3])
    if vocabs[:2] == ("get", "prot"):
        return [Vocab("prot"), *PROTOCOL, Vocab("ok")]
    timed = [Vocab("tsta"), *stamp, Vocab("ok")]
    if vocabs[:2] == ("get", "icmd"):
        return [*_modes(board, vocabs[2], asked[3:]), *timed]
    found = known().get(vocabs) or known().get(vocabs[:2])
    if found is None:
        raise WireError(f"there is no request {' '.join(vocabs)}")
    call, said = found
    arguments = list(asked[len(said.request) :])
    if _counted(call.name):
        count = arguments.pop(0)
        if any(len(values) != count for values in arguments):
            raise WireError(f"{call.name} is of {count} joints")
    given: list[Any] = []
    for place, (_, field) in enumerate(call.arguments):
        if isinstance(field, Nested):
            given.append(Bottle(arguments[place:]))
        else:
            given.append(read_value(field, arguments[place]))
    returned = answer(board, call.name, given)
    outcome, *values = returned if isinstance(returned, tuple) else (returned,)
    if not outcome:
        raise CallFailed(outcome.code)
    reply: list[Any] = []
    for part in said.reply:
        if part == "*":
            reply += [_written(field, value) for field, value in zip(call.results[1:], values, strict=True)]
        elif part == "t":
            return [*reply, *timed]
        else:
            reply.append(Vocab(part))
    return [*reply, Vocab("ok")]


def _modes(board: JointBoard, what: str, arguments: Sequence[Any]) -> list[Any]:
    """What ``[get] [icmd]`` is answered; releases with services stream the modes alone."""
    read = board.control_mode
    if what == "cmod":
        return [Vocab("is"), int(arguments[0]), _vocab(read(int(arguments[0])))]
    if what == "cmds":
        joints: Sequence[int] = range(board.getAxesRPC()[1])
    elif what == "cmog":
        joints = [int(joint) for joint in arguments[1]]
    else:
        raise WireError(f"there is no request get icmd {what}")
    return [Vocab("is"), Vocab(what), [_vocab(read(joint)) for joint in joints]]


def _counted(method: str) -> bool:
    return "Group" in method


def _vocab(code: int) -> Any:
    return vocab32(code)


def _written(field: FieldCodec, value: Any) -> Any:
    """A value as it stands in a Bottle."""
    if isinstance(field, ListOf) and isinstance(field.element, Nested):  # one Bottle, where 4.0 has some
        return [word for bottle in value for word in bottle.plain]
    if isinstance(field, ListOf):
        return [_written(field.element, element) for element in value]
    if field is MODE:
        return _vocab(int(value))
    if field is TRUNCATED or field is FLOAT64:
        return float(value)
    if isinstance(field, Integer) or field is BOOLEAN:
        return int(value)
    if isinstance(value, Bottle):
        return value.plain
    return str(value)


def read_value(field: FieldCodec, value: Any) -> Any:
    """A value out of a Bottle; raises `WireError` where it is of another kind."""
    try:
        if isinstance(field, ListOf):
            value = list(value) if isinstance(value, list) else [None]  # which no element is
            if isinstance(field.element, Nested):
                return [Bottle(value)]
            return [read_value(field.element, element) for element in value]
        if isinstance(field, Nested):
            return Bottle(value if isinstance(value, list) else [value])
        if field is MODE:
            return Vocab32.encode(value) if isinstance(value, str) else int(value)
        if field is TRUNCATED or field is FLOAT64:
            return float(value)
        if field is BOOLEAN:
            return bool(value)
        return str(value) if field is TEXT else int(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise WireError(str(error)) from None

"""A board's methods as Bottles of vocabs, the protocol of YARP 3.x at ``/rpc:i`` (`RPCMessagesParser.cpp`).

The reply to ``[get] [enc] 0`` is ``[is] [enc] 12.5 [tsta] 7 1795143618.02 [ok]``, or ``[fail]``. The length of a list
of joints precedes it: ``[set] [posg] 2 (0 1) (10.0 20.0)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from yarp_compat.dev.controlboard.board import JointBoard, answer
from yarp_compat.dev.controlboard.messages import MODE, TRUNCATED, ControlBoardMsgs, VocabForm
from yarp_compat.dev.fields import BOOLEAN, FLOAT64, TEXT, FieldCodec, Integer, ListOf, Nested
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.service import Call
from yarp_compat.os.data.bottle import Bottle
from yarp_compat.os.data.vocab import Vocab32
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.values import Vocab, vocab32

PROTOCOL = (1, 9, 0)
"""The reply to ``[get] [prot]`` since 2.3.70; clients of 3.x require its first and second numbers."""

_FAILED = ReturnValue(ReturnCode.METHOD_FAILED)


@cache
def methods_by_vocabs() -> dict[tuple[str, ...], tuple[Call, VocabForm]]:
    """Return the methods by the vocabs of their requests."""
    methods = {}
    for name, call in ControlBoardMsgs.calls().items():
        form = form_of(name)
        if form is not None:
            methods[form.request] = (call, form)
    return methods


def form_of(method: str) -> VocabForm | None:
    """Return a method's form in the vocabs of 3.x; None if 3.x does not call it by vocabs."""
    form: VocabForm | None = getattr(getattr(ControlBoardMsgs, method), "vocabs", None)
    return form


def request(method: str, arguments: Sequence[Any]) -> list[Any]:
    """Return the Bottle that requests a method; raises `WireError` if 3.x lacks it or an argument is invalid."""
    call, form = ControlBoardMsgs.calls()[method], form_of(method)
    if form is None:
        raise WireError(f"control boards of YARP 3 do not have {method}")
    bottle: list[Any] = list(map(Vocab, form.request))
    if _counted(method):
        bottle.append(len(arguments[0]))
    for (name, field), value in zip(call.arguments, arguments, strict=True):
        try:
            written = _to_element(field, value)
        except (TypeError, ValueError, OverflowError) as error:
            raise WireError(f"{method}, {name}: {error}") from None
        if isinstance(value, Bottle):
            bottle += written
        else:
            bottle.append(written)
    return bottle


def results(method: str, reply: Sequence[Any]) -> tuple[Any, ...]:
    """Return the outcome, and the results if it is ok; raises `WireError` for an invalid reply."""
    call, pattern = ControlBoardMsgs.calls()[method], form_of(method)
    assert pattern is not None
    if not reply or reply[-1] != "ok":
        return (_FAILED,)
    fields = call.results[1:]
    if "*" not in pattern.reply:
        return (OK,)
    first = pattern.reply.index("*")
    if len(reply) < first + len(fields) + 1:
        raise WireError(f"{method} returns {len(fields)} values, but the reply is {list(reply)}")
    return OK, *(read_value(field, value) for field, value in zip(fields, reply[first:], strict=False))


def respond(board: JointBoard, request: Sequence[Any], stamp: tuple[int, float]) -> list[Any]:
    """Return a board's reply to a Bottle; ``stamp`` (a number and seconds) is for replies that contain one."""
    try:
        return _answer(board, request, stamp)
    except (WireError, CallFailed, NotImplementedError, IndexError, TypeError, ValueError, OverflowError):
        return [Vocab("fail")]


def _answer(board: JointBoard, request: Sequence[Any], stamp: tuple[int, float]) -> list[Any]:
    vocabs = tuple(str(value) for value in request[:3])
    if vocabs[:2] == ("get", "prot"):
        return [Vocab("prot"), *PROTOCOL, Vocab("ok")]
    timed = [Vocab("tsta"), *stamp, Vocab("ok")]
    if vocabs[:2] == ("get", "icmd"):
        return [*_modes(board, vocabs[2], request[3:]), *timed]
    entry = methods_by_vocabs().get(vocabs) or methods_by_vocabs().get(vocabs[:2])
    if entry is None:
        raise WireError(f"unknown request {' '.join(vocabs)}")
    call, form = entry
    arguments = list(request[len(form.request) :])
    if _counted(call.name):
        count = arguments.pop(0)
        if any(len(values) != count for values in arguments):
            raise WireError(f"{call.name}: a list does not have {count} joints")
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
    for part in form.reply:
        if part == "*":
            reply += [_to_element(field, value) for field, value in zip(call.results[1:], values, strict=True)]
        elif part == "t":
            return [*reply, *timed]
        else:
            reply.append(Vocab(part))
    return [*reply, Vocab("ok")]


def _modes(board: JointBoard, what: str, arguments: Sequence[Any]) -> list[Any]:
    """Return the reply to ``[get] [icmd]``; newer releases only stream the modes."""
    read = board.control_mode
    if what == "cmod":
        return [Vocab("is"), int(arguments[0]), _vocab(read(int(arguments[0])))]
    if what == "cmds":
        joints: Sequence[int] = range(board.getAxesRPC()[1])
    elif what == "cmog":
        joints = [int(joint) for joint in arguments[1]]
    else:
        raise WireError(f"unknown request get icmd {what}")
    return [Vocab("is"), Vocab(what), [_vocab(read(joint)) for joint in joints]]


def _counted(method: str) -> bool:
    return "Group" in method


def _vocab(code: int) -> Any:
    return vocab32(code)


def _to_element(field: FieldCodec, value: Any) -> Any:
    """Convert a value to an element of a Bottle."""
    if isinstance(field, ListOf) and isinstance(field.element, Nested):  # 3.x has one Bottle, 4.0 several
        return [element for bottle in value for element in bottle.plain]
    if isinstance(field, ListOf):
        return [_to_element(field.element, element) for element in value]
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
    """Convert an element of a Bottle to a value; raises `WireError` for another type."""
    try:
        if isinstance(field, ListOf):
            value = list(value) if isinstance(value, list) else [None]  # an invalid element
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

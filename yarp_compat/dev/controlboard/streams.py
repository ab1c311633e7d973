"""The streams of control boards: the joints' state, ``/stateExt:o``, and commands without a reply, ``/command:i``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.fields import Structure
from yarp_compat.os.data.bottle import Bottle
from yarp_compat.overriding import override
from yarp_compat.sig.vector import Vector, read_numbers, write_numbers
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

Numbers = NDArray[Any]

_DOUBLE, _FLOAT, _INT = (np.dtype(name) for name in ("<f8", "<f4", "<i4"))
_STATE = {
    "jointPosition": _DOUBLE, "jointVelocity": _DOUBLE, "jointAcceleration": _DOUBLE, "motorPosition": _DOUBLE,
    "motorVelocity": _DOUBLE, "motorAcceleration": _DOUBLE, "torque": _DOUBLE, "pwmDutycycle": _DOUBLE,
    "current": _DOUBLE, "controlMode": _INT, "interactionMode": _INT,
}  # fmt: skip
_LAYOUTS = {Profile.YARP3: _STATE, Profile.YARP4: _STATE | {"pwmDutycycle": _FLOAT, "temperature": _FLOAT}}


class JointData(Portable):
    """The state of all joints (`jointData.thrift`): degrees, newton meters, percent, amperes, vocabs of modes.

    ``values`` holds the valid quantities by YARP's names; an invalid one has ``axes`` zeros on the wire. 4.0 added
    temperatures, and writes them and the duty cycles as 32-bit floats.
    """

    def __init__(self, axes: int = 0, values: dict[str, Numbers] | None = None) -> None:
        self.axes = axes
        self.values = values or {}

    @override
    def _write(self, out: ElementWriter) -> None:
        layout = _LAYOUTS[out.profile]
        out.begin(2 * len(layout))
        for name, kind in layout.items():
            value = self.values.get(name)
            write_numbers(out, np.zeros(self.axes, kind) if value is None else np.ascontiguousarray(value, kind))
            out.boolean(value is not None)

    @override
    def _read(self, source: ElementReader) -> None:
        count = source.begin()
        layout = next((known for known in _LAYOUTS.values() if 2 * len(known) == count), None)
        if layout is None:
            raise WireError(f"the state of a control board has 22 or 24 fields, not {count}")
        values = {}
        axes = 0
        for name, kind in layout.items():
            numbers = read_numbers(source, kind)
            axes = max(axes, len(numbers))
            if source.boolean():
                values[name] = numbers
        source.end()
        self.axes, self.values = axes, values


@dataclass
class CommandMessage(Structure):
    """A command (`PortablePair<Bottle, Vector>`): what to set, of which joints, and the numbers."""

    head: Bottle = field(default_factory=Bottle)
    body: Vector = field(default_factory=Vector)


COMMANDS = {
    "positionMoveAllRPC": ("poss", "ipos poss"),
    "velocityMoveOneRPC": ("vmo", "ivel vmo"),
    "velocityMoveAllRPC": ("vmos", "ivel vmos"),
    "velocityMoveGroupRPC": ("vmog", "ivel vmog"),
    "setRefPositionOneRPC": ("dpo", "ipod dpo"),
    "setRefPositionAllRPC": ("dpos", "ipod dpos"),
    "setRefPositionGroupRPC": ("dpog", "ipod dpog"),
    "setRefTorqueOneRPC": ("dtq", "itrq dtq"),
    "setRefTorqueAllRPC": ("dtqs", "itrq dtqs"),
    "setRefTorqueGroupRPC": ("dtqg", "itrq dtqg"),
    "setRefCurrentOneRPC": ("icur ref", "icur ref"),
    "setRefCurrentAllRPC": ("icur refs", "icur refs"),
    "setRefCurrentGroupRPC": ("icur refg", "icur refg"),
    "setRefDutyCycleOneRPC": ("ipwm ref", "ipwm ref"),
    "setRefDutyCycleAllRPC": ("ipwm refs", "ipwm refs"),
}
"""The streamed methods, and the start of their commands in 3.x and 4.0 (`StreamingMessagesParser.cpp`)."""

_METHODS = {tuple(heads.split()): name for name, both in COMMANDS.items() for heads in both}
_RPC = "positionMoveAllRPC"  # clients call it at the RPC port, and wait for a reply


def is_streamed(method: str) -> bool:
    """Whether YARP's clients stream a method; a streamed method has no outcome."""
    return method in COMMANDS and method != _RPC


def command(method: str, arguments: Sequence[Any], profile: Profile) -> CommandMessage:
    """Return the command that calls a method with these arguments."""
    vocabs = COMMANDS[method][profile is Profile.YARP4].split()
    head: list[Any] = list(map(Vocab, vocabs))
    if "One" in method:
        joint, value = arguments
        return CommandMessage(Bottle([*head, int(joint)]), Vector([float(value)]))
    if "Group" in method:
        joints, values = arguments
        return CommandMessage(Bottle([*head, len(joints), list(map(int, joints))]), Vector(list(map(float, values))))
    return CommandMessage(Bottle(head), Vector(list(map(float, arguments[0]))))


def parse_command(message: CommandMessage) -> tuple[str, list[Any]]:
    """Return the method and arguments of a command of either release; raises `WireError` if it is invalid."""
    parts = message.head.plain
    numbers = list(message.body)
    for count in (2, 1):
        method = _METHODS.get(tuple(map(str, parts[:count])))
        if method is not None:
            break
    else:
        raise WireError(f"unknown command {message.head.toString()}")
    joints = parts[count:]
    if "One" in method:
        if len(joints) != 1 or not isinstance(joints[0], int) or len(numbers) != 1:
            raise WireError(f"{method} sets one joint, not {message.head.toString()} with {len(numbers)} numbers")
        return method, [joints[0], numbers[0]]
    if "Group" not in method:
        return method, [numbers]
    if len(joints) != 2 or not isinstance(joints[1], list) or not len(joints[1]) == joints[0] == len(numbers):
        raise WireError(f"{method} needs as many joints as numbers, not {message.head.toString()} with {len(numbers)}")
    return method, [joints[1], numbers]

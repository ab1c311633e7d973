"""The one-letter commands that people type at a port and tools send, in YARP's words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from yarp_compat.wire import command
from yarp_compat.wire.command import PortCommand

if TYPE_CHECKING:
    from yarp_compat.ports.port import PortCore


def obey(port: PortCore, word: PortCommand) -> tuple[str, ...]:
    """Obey a command.

    The lines that text carriers answer. ``i`` (end the process) is obeyed by no port that faces a network.
    """
    if word.key == "/":
        return (port.add_output(word.text)[1],)
    if word.key == "!":
        return (port.remove_output(word.text[1:])[1],)
    if word.key == "~":
        return (port.remove_input(word.text[1:])[1],)
    if word.key == "*":
        return describe(port)
    return command.HELP if word.key in ("?", "h") else command.NOT_UNDERSTOOD


def describe(port: PortCore) -> tuple[str, ...]:
    """The port and its connections."""
    outs = [f"There is an output connection from {r.source} to {r.target} using {r.carrier}" for r in port.outputs()]
    ins = [f"There is an input connection from {r.source} to {r.target} using {r.carrier}" for r in port.inputs()]
    return (
        f"This is {port.name} at {port.contact.uri}",
        *(outs or ["There are no outgoing connections"]),
        *(ins or ["There are no incoming connections"]),
    )

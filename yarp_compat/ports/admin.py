"""Administrative commands, which YARP's companion, yarpmanager and robot interfaces send to a port.

The texts of the answers are YARP's (measured; ``PortCore.cpp``), because tools match their first words. This module
also executes the one-letter port commands, which people type and tools send.
"""

from __future__ import annotations

import os
import platform
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

from yarp_compat.ports.connecting import ConnectingPort
from yarp_compat.ports.connections import AnyOutput
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.service import DSCP, PRIORITIES
from yarp_compat.ports.sockets import service, set_service
from yarp_compat.wire import framing
from yarp_compat.wire.carriers import CARRIERS
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.framing import PortCommand
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import dict_of
from yarp_compat.wire.values import Vocab

_HELP = (
    "[help]                  # give this help",
    "[ver]                   # report protocol version information",
    "[add] $portname         # add an output connection",
    "[add] $portname $car    # add an output with a given protocol",
    "[del] $portname         # remove an input or output connection",
    "[list] [in]             # list input connections",
    "[list] [out]            # list output connections",
    "[list] [in]  $portname  # give details for input",
    "[list] [out] $portname  # give details for output",
    "[prop] [get]            # get all user-defined port properties",
    "[prop] [get] $prop      # get a user-defined port property (prop, val)",
    "[prop] [set] $prop $val # set a user-defined port property (prop, val)",
    "[prop] [get] $portname  # get Qos properties of a connection to/from a port",
    "[prop] [set] $portname  # set Qos properties of a connection to/from a port",
    "[prop] [get] $cur_port  # get information about current process (e.g., scheduling priority, pid)",
    "[prop] [set] $cur_port  # set properties of the current process (e.g., scheduling priority, pid)",
    "[atch] [out] $prop      # attach a portmonitor plug-in to the port's output",
    "[atch] [in]  $prop      # attach a portmonitor plug-in to the port's input",
    "[dtch] [out]            # detach portmonitor plug-in from the port's output",
    "[dtch] [in]             # detach portmonitor plug-in from the port's input",
)
_NO_PLUGINS = "this port does not support portmonitor plug-ins: it is not a C++ program"
_OK, _FAIL = Vocab("ok"), Vocab("fail")
_UNKNOWN = [_FAIL, "send [help] for list of valid commands"]
MOST_PROPERTIES = 1000  # limit for one port; further properties are refused


def answer(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    """Execute an administrative command and return the answer."""
    known = _COMMANDS.get(_word(words, 0))
    return known(port, words) if known else list(_UNKNOWN)


def _word(words: Sequence[Any], index: int) -> str:
    """Return a word of a command, a vocab or a string; "" if missing."""
    value = words[index] if index < len(words) else ""
    return str(value) if isinstance(value, str) else ""


def _is_input(words: Sequence[Any]) -> bool:
    return _word(words, 1) == "in"


def _pid(port: ConnectingPort, _words: Sequence[Any]) -> list[Any]:
    """Answer ROS's ``getPid``, which YARP 3's ports support and YARP 4's do not: clients detect the release by it."""
    return [1, "", os.getpid()] if port.profile is Profile.YARP3 else list(_UNKNOWN)


def _add(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    target, carrier = _word(words, 1), _word(words, 2)
    done, message = port.add_output(f"{carrier}:/{target}" if carrier else target)
    return [0 if done else -1, message + "\r\n"]


def _del(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    name = _word(words, 1)
    out, out_message = port.remove_output(name)
    into, in_message = port.remove_input(name)
    messages = [out_message, in_message] if out == into else [out_message if out else in_message]
    return [0 if out or into else -1, "".join(f"{line}\r\n" for line in messages)]


def _list(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    incoming, wanted = _is_input(words), _word(words, 2)
    routes = port.inputs() if incoming else port.outputs()
    names = [(r.source if incoming else r.target, r) for r in routes]
    if not wanted:
        return [name for name, _ in names if name]
    return [part for name, route in names if name == wanted for part in _describe(route)]


def _describe(route: ConnectionRoute) -> list[Any]:
    details: list[Any] = [["from", route.source], ["to", route.target], ["carrier", route.carrier]]
    if CARRIERS[route.carrier].connectionless:
        details.append(["connectionless", 1])
    return details


def _parameters(port: ConnectingPort, words: Sequence[Any], answer: list[Any]) -> list[Any]:
    """Answer for a carrier's parameters, which are not supported, or a portmonitor's, which this port never has."""
    incoming, wanted = _is_input(words), _word(words, 2)
    if not wanted:
        return [-1, "target port is not specified.\r\n"]
    if wanted == port.name:
        return [_FAIL, f"No port modifier is attached to the {'input' if incoming else 'output'}"]
    names = [r.source for r in port.inputs()] if incoming else [r.target for r in port.outputs()]
    direction = "from" if incoming else "to"
    if wanted in names:
        return [part.format(f"{direction} {wanted}") if isinstance(part, str) else part for part in answer]
    return [-1, f"Could not find an incoming connection {direction} {wanted}\r\n"]


def _prop(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    action, key = _word(words, 1), _word(words, 2)
    if action == "get":
        return _prop_get(port, key)
    if action == "set":
        return _prop_set(port, key, words)
    return [_FAIL, "property action not known"]


def _prop_get(port: ConnectingPort, key: str) -> list[Any]:
    if not key:
        return [[name, value] for name, value in sorted(port.properties.items())]
    if key == port.name:
        return _describe_process(port)
    if key.startswith("/"):
        if connections := _connections(port, key):
            sched = {"policy": 0, "priority": 0, "tid": threading.get_native_id()}
            return [["sched", sched], ["qos", {"tos": service(connections[0].sock)}]]
        return [_FAIL, f"cannot find any connection to/from {key}"]
    return [port.properties[key]] if key in port.properties else []


def _describe_process(port: ConnectingPort) -> list[Any]:
    """Describe the port, its process and its machine."""
    program, *arguments = sys.orig_argv or ["python"]
    process = {
        "arguments": " ".join(arguments), "name": os.path.basename(program),  # noqa: PTH119  # a program's name
        "pid": os.getpid(), "policy": 0, "priority": 0,
    }  # fmt: skip
    kind = {"is_input": int(port.is_input), "is_output": int(port.is_output), "is_rpc": int(port.rpc)}
    return [
        ["sched", {"policy": 0, "priority": 0, "tid": threading.get_native_id()}],
        ["process", process],
        ["platform", {"hostname": port.contact.host, "os": platform.system()}],
        ["port", {**kind, "type": port.type_name}],
    ]


def _connections(port: ConnectingPort, name: str) -> list[Input | AnyOutput]:
    """Return the connections to and from a port."""
    every = (*port.connections.inputs, *port.connections.outputs)
    return [c for c in every if name in (c.route.source, c.route.target) and name != port.name]


def _requested_service(words: Sequence[Any]) -> int | None:
    """Return the type of service in ``(qos ((tos 144)))``, ``(qos ((dscp AF41)))``, ``(qos ((priority HIGH)))``."""
    groups = [part for part in words if isinstance(part, list) and len(part) == 2 and part[0] == "qos"]
    settings: Any = groups[0][1] if groups else {}
    requested = settings if isinstance(settings, dict) else dict_of(settings) if isinstance(settings, list) else {}
    for key, classes in (("priority", PRIORITIES), ("dscp", DSCP)):
        value = requested.get(key)
        known = classes.get(str(value), value if key == "dscp" else None)
        if isinstance(known, int) and 0 <= known < 64:
            return known << 2
    tos = requested.get("tos")
    return tos if type(tos) is int and tos >= 0 else None


def _prop_set(port: ConnectingPort, key: str, words: Sequence[Any]) -> list[Any]:
    """Store a property, or set the type of service of a connection. Thread priorities are accepted but not applied."""
    if not key or len(words) < 4 or (key not in port.properties and len(port.properties) >= MOST_PROPERTIES):
        return [_FAIL]
    if key.startswith("/"):
        connections, tos = _connections(port, key), _requested_service(words[3:])
        done = all(set_service(connection.sock, tos) for connection in connections) if tos is not None else True
        return [_OK if done and (connections or key == port.name) else _FAIL]
    port.properties[key] = words[3]
    return [_OK]


def _plug(words: Sequence[Any], verb: str, *answer: str) -> list[Any]:
    if _word(words, 1) not in ("in", "out"):
        return [_FAIL, f"{verb} command must be followed by [out] or [in]"]
    return [_FAIL, *answer]


_COMMANDS: dict[str, Callable[[ConnectingPort, Sequence[Any]], list[Any]]] = {
    "help": lambda *_: [Vocab("many"), *_HELP],
    "ver": lambda *_: [Vocab("ver"), 1, 2, 3],
    "getPid": _pid,
    "pid": _pid,
    "add": _add,
    "del": _del,
    "list": _list,
    "set": lambda port, words: _parameters(port, words, [0, "Configured connection {}\r\n"]),
    "get": lambda port, words: _parameters(port, words, [{}]),
    "prop": _prop,
    "atch": lambda _, words: _plug(words, "attach", _NO_PLUGINS),
    "dtch": lambda _, words: _plug(words, "detach"),
}


def execute(port: ConnectingPort, word: PortCommand) -> tuple[str, ...]:
    """Execute a port command; return the answer's lines, for text carriers. ``i`` (end the process) is refused."""
    if word.key == "/":
        return (port.add_output(word.text)[1],)
    if word.key == "!":
        return (port.remove_output(word.text[1:])[1],)
    if word.key == "~":
        return (port.remove_input(word.text[1:])[1],)
    if word.key == "*":
        return describe(port)
    return framing.HELP if word.key in ("?", "h") else framing.NOT_UNDERSTOOD


def describe(port: ConnectingPort) -> tuple[str, ...]:
    """Return the description of the port and its connections."""
    outs = [f"There is an output connection from {r.source} to {r.target} using {r.carrier}" for r in port.outputs()]
    ins = [f"There is an input connection from {r.source} to {r.target} using {r.carrier}" for r in port.inputs()]
    return (
        f"This is {port.name} at {port.contact.uri}",
        *(outs or ["There are no outgoing connections"]),
        *(ins or ["There are no incoming connections"]),
    )

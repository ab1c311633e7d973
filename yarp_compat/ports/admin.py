"""The administrative commands, which the companion, yarpmanager and robot interfaces send to a port.

The answers' texts are YARP's own (measured; ``PortCore.cpp``), as tools look at how they begin. Ports obey the
one-letter commands that people type, and tools send, here too.
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
_NO_PLUGINS = "portmonitor plug-ins are not offered by this port: it is no C++ program"
_OK, _FAIL = Vocab("ok"), Vocab("fail")
_UNKNOWN = [_FAIL, "send [help] for list of valid commands"]
MOST_PROPERTIES = 1000  # properties of one port; more are not kept


def answer(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    """The answer to an administrative command."""
    known = _COMMANDS.get(_word(words, 0))
    return known(port, words) if known else list(_UNKNOWN)


def _word(words: Sequence[Any], index: int) -> str:
    """A word of a command: vocabs and strings are both taken."""
    value = words[index] if index < len(words) else ""
    return str(value) if isinstance(value, str) else ""


def _is_input(words: Sequence[Any]) -> bool:
    return _word(words, 1) == "in"


def _pid(port: ConnectingPort, _words: Sequence[Any]) -> list[Any]:
    """ROS' question, which YARP 3's ports know and YARP 4's do not: that tells them apart."""
    return [1, "", os.getpid()] if port.profile is Profile.YARP3 else list(_UNKNOWN)


def _add(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    target, carrier = _word(words, 1), _word(words, 2)
    done, told = port.add_output(f"{carrier}:/{target}" if carrier else target)
    return [0 if done else -1, told + "\r\n"]


def _del(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    name = _word(words, 1)
    out, told_out = port.remove_output(name)
    into, told_in = port.remove_input(name)
    told = [told_out, told_in] if out == into else [told_out if out else told_in]
    return [0 if out or into else -1, "".join(f"{line}\r\n" for line in told)]


def _list(port: ConnectingPort, words: Sequence[Any]) -> list[Any]:
    incoming, wanted = _is_input(words), _word(words, 2)
    routes = port.inputs() if incoming else port.outputs()
    names = [(r.source if incoming else r.target, r) for r in routes]
    if not wanted:
        return [name for name, _ in names if name]
    return [part for name, route in names if name == wanted for part in _described(route)]


def _described(route: ConnectionRoute) -> list[Any]:
    told: list[Any] = [["from", route.source], ["to", route.target], ["carrier", route.carrier]]
    if CARRIERS[route.carrier].connectionless:
        told.append(["connectionless", 1])
    return told


def _parameters(port: ConnectingPort, words: Sequence[Any], found: list[Any]) -> list[Any]:
    """Parameters of a connection's carrier, which has none here, or of a portmonitor, which this port never has."""
    incoming, wanted = _is_input(words), _word(words, 2)
    if not wanted:
        return [-1, "target port is not specified.\r\n"]
    if wanted == port.name:
        return [_FAIL, f"No port modifier is attached to the {'input' if incoming else 'output'}"]
    names = [r.source for r in port.inputs()] if incoming else [r.target for r in port.outputs()]
    direction = "from" if incoming else "to"
    if wanted in names:
        return [part.format(f"{direction} {wanted}") if isinstance(part, str) else part for part in found]
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
        return _about(port)
    if key.startswith("/"):
        if found := _with(port, key):
            sched = {"policy": 0, "priority": 0, "tid": threading.get_native_id()}
            return [["sched", sched], ["qos", {"tos": service(found[0].sock)}]]
        return [_FAIL, f"cannot find any connection to/from {key}"]
    return [port.properties[key]] if key in port.properties else []


def _about(port: ConnectingPort) -> list[Any]:
    """About the port, its process and its machine."""
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


def _with(port: ConnectingPort, name: str) -> list[Input | AnyOutput]:
    """The connections with a port."""
    every = (*port.connections.inputs, *port.connections.outputs)
    return [one for one in every if name in (one.route.source, one.route.target) and name != port.name]


def _asked_service(words: Sequence[Any]) -> int | None:
    """The type of service in ``(qos ((tos 144)))``, ``(qos ((dscp AF41)))`` or ``(qos ((priority HIGH)))``, if any."""
    groups = [word for word in words if isinstance(word, list) and len(word) == 2 and word[0] == "qos"]
    found: Any = groups[0][1] if groups else {}
    asked = found if isinstance(found, dict) else dict_of(found) if isinstance(found, list) else {}
    for key, classes in (("priority", PRIORITIES), ("dscp", DSCP)):
        value = asked.get(key)
        known = classes.get(str(value), value if key == "dscp" else None)
        if isinstance(known, int) and 0 <= known < 64:
            return known << 2
    tos = asked.get("tos")
    return tos if type(tos) is int and tos >= 0 else None


def _prop_set(port: ConnectingPort, key: str, words: Sequence[Any]) -> list[Any]:
    """Keep a property, or set the service of the packets to a port. Priorities of threads are accepted, not applied."""
    if not key or len(words) < 4 or (key not in port.properties and len(port.properties) >= MOST_PROPERTIES):
        return [_FAIL]
    if key.startswith("/"):
        found, tos = _with(port, key), _asked_service(words[3:])
        done = all(set_service(one.sock, tos) for one in found) if tos is not None else True
        return [_OK if done and (found or key == port.name) else _FAIL]
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


def obey(port: ConnectingPort, word: PortCommand) -> tuple[str, ...]:
    """The lines that text carriers answer to a command. No port that faces a network obeys ``i`` (end the process)."""
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
    """The port and its connections."""
    outs = [f"There is an output connection from {r.source} to {r.target} using {r.carrier}" for r in port.outputs()]
    ins = [f"There is an input connection from {r.source} to {r.target} using {r.carrier}" for r in port.inputs()]
    return (
        f"This is {port.name} at {port.contact.uri}",
        *(outs or ["There are no outgoing connections"]),
        *(ins or ["There are no incoming connections"]),
    )

"""The commands of ``midspan yarp`` for names and connections: where, list, ping, connect and others."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any

from bridge.cli.arguments import add_verb
from bridge.cli.output import CliError, print_json
from bridge.text import clean, near
from yarp_compat.naming import config, connections
from yarp_compat.naming.client import TIMEOUT, NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports import text_client
from yarp_compat.ports.naming import NamingConfigError, NamingError
from yarp_compat.wire.text import from_text


def add_server_arguments(parser: argparse.ArgumentParser, timeout: float = TIMEOUT) -> None:
    """Add the arguments for the name server and the timeout."""
    parser.add_argument("--server", type=_address, metavar="HOST:PORT", help="the name server (default: yarp.conf's)")
    parser.add_argument(
        "--timeout", type=float, default=timeout, metavar="SECONDS",
        help="timeout of each step in seconds (default %(default)g)",
    )  # fmt: skip


def client(args: argparse.Namespace) -> NameClient:
    """Return the client of the name server that the arguments choose."""
    if not 0 < args.timeout < math.inf:
        raise CliError("--timeout must be more than 0 seconds")
    return NameClient(args.server, timeout=args.timeout)


def register(verbs: Any) -> None:
    where = _add(verbs, "where", "the name server's address, and whether it responds")
    where.add_argument("--json", action="store_true", help="print JSON")
    name = _add(
        verbs, "name", "send any command to the name server",
        "Sends a command to the name server and prints its reply. 'help' lists the commands.",
    )  # fmt: skip
    name.add_argument("words", nargs="+", metavar="WORD", help="the command: query /port, get /port key, list, ...")
    ports = _add(verbs, "list", "all registered ports")
    ports.add_argument("prefix", nargs="?", default="", help="only the port of this name, and ports below it")
    ports.add_argument("--json", action="store_true", help="print JSON")
    exists = _add(
        verbs, "exists", "check whether a port responds, or two are connected",
        "Exits with code 0 if the port is registered and responds, or if the first port writes to the second; else 1.",
    )  # fmt: skip
    exists.add_argument("port")
    exists.add_argument("target", nargs="?", help="check the connection to this port")
    ping = _add(verbs, "ping", "a port's report on itself and its connections")
    ping.add_argument("port")
    connect = _add(
        verbs, "connect", "connect two ports",
        "Connects two ports of any programs. Without ports, or with one, lists persistent connections.",
    )  # fmt: skip
    connect.add_argument("source", nargs="?", help="the port that writes")
    connect.add_argument("target", nargs="?", help="the port that reads")
    connect.add_argument("carrier", nargs="?", default="", help="tcp (default), fast_tcp, udp, ...")
    persist = connect.add_mutually_exclusive_group()
    persist.add_argument(
        "--persist", dest="mode", action="store_const", const="",
        help="let the name server connect the ports whenever both are registered",
    )  # fmt: skip
    for mode, end in (("from", "writes"), ("to", "reads")):
        persist.add_argument(
            f"--persist-{mode}", dest="mode", action="store_const", const=mode,
            help=f"like --persist, until the port that {end} is closed",
        )  # fmt: skip
    disconnect = _add(verbs, "disconnect", "end a connection")
    disconnect.add_argument("source", help="the port that writes")
    disconnect.add_argument("target", help="the port that reads")
    disconnect.add_argument("--persist", action="store_true", help="remove a persistent connection")
    _add(
        verbs, "clean", "unregister dead ports",
        "Tries each registered port, and unregisters those that do not respond.",
    )  # fmt: skip


def _add(verbs: Any, name: str, text: str, description: str | None = None) -> argparse.ArgumentParser:
    parser = add_verb(verbs, name, VERBS[name], text, description or f"Shows {text}.", hub=False)
    add_server_arguments(parser)
    return parser


def _where(args: argparse.Namespace) -> int:
    names = client(args)
    address, space = names.address, config.namespace()
    file = None if args.server else str(config.file())
    try:
        names.lines(["query", space])
        problem = ""
    except NamingError as err:
        problem = str(err)
    if args.json:
        print_json({"host": address.host, "port": address.port, "name": space, "file": file, "reachable": not problem})
    else:
        print(f"{space} at {address.host} port {address.port}, {'does not respond' if problem else 'responds'}")
        print(f"configured by {file or '--server'}; web page: http://{address.host}:{address.port}/")
    if problem:
        raise CliError(problem)
    return 0


def _name(args: argparse.Namespace) -> int:
    values = from_text(" ".join(args.words))
    # the text carrier preserves quotes, unlike the usual carrier of name clients
    for line in text_client.ask(client(args).contact, values, timeout=args.timeout):
        if not line.startswith("*** "):
            print(clean(line))
    return 0


def _list(args: argparse.Namespace) -> int:
    ports = client(args).list(args.prefix)
    if args.json:
        print_json([{"name": c.name, "host": c.host, "port": c.port, "carrier": c.carrier} for c in ports])
    else:
        for contact in ports:
            print(clean(f"{contact.name}  {contact.uri}"))
    return 0


def _exists(args: argparse.Namespace) -> int:
    names = client(args)
    if args.target is None:
        connected = connections.exists(names, args.port, timeout=args.timeout)
        text = f"{args.port} {'responds' if connected else 'is not registered, or does not respond'}"
    else:
        carrier = connections.carrier_between(names, args.port, args.target, timeout=args.timeout)
        connected = bool(carrier)
        text = f"{args.port} is {'' if connected else 'not '}connected to {args.target}{carrier and f' by {carrier}'}"
    print(clean(text), file=sys.stdout if connected else sys.stderr)
    return 0 if connected else 1


def _ping(args: argparse.Namespace) -> int:
    names = client(args)
    for line in connections.ping(names, _registered_name(names, args.port), timeout=args.timeout):
        print(clean(line))
    return 0


def _connect(args: argparse.Namespace) -> int:
    names = client(args)
    if args.target is None:
        for answer in names.command(["subscribe", *filter(None, [args.source])])[1:]:
            print(clean(_subscription(answer)))
        return 0
    target = f"{args.carrier}:/{args.target}" if args.carrier else args.target
    if args.mode is not None:
        _check_accepted(names.command(["subscribe", args.source, target, *filter(None, [args.mode])]))
        print(clean(f"{args.source} will be connected to {target} whenever both are registered"))
        return 0
    for port in (args.source, args.target):
        _registered_name(names, port)
    print(clean(connections.connect(names, args.source, args.target, args.carrier, timeout=args.timeout)))
    return 0


def _disconnect(args: argparse.Namespace) -> int:
    names = client(args)
    if args.persist:
        _check_accepted(names.command(["unsubscribe", args.source, args.target]))
        print(clean(f"{args.source} will no longer be connected to {args.target}; an open connection stays"))
        return 0
    print(clean(connections.disconnect(names, args.source, args.target, timeout=args.timeout)))
    return 0


def _clean(args: argparse.Namespace) -> int:
    names = client(args)
    removed = 0
    for contact in names.list():
        if contact.carrier in ("mcast", "topic") or contact.name == config.namespace():
            continue
        if not connections.responds(contact, timeout=args.timeout):
            names.unregister(contact.name)
            removed += 1
            print(clean(f"{contact.name} does not respond at {contact.uri}: unregistered"))
    names.lines(["gc"])
    print(f"{removed} of the registered ports were dead" if removed else "all registered ports respond")
    return 0


def _registered_name(names: NameClient, port: str) -> str:
    """Return the name of a registered port; raises an error with similar names if it is not registered."""
    if names.query(port) is None:
        alike = near(port, [contact.name for contact in names.list()])
        hint = f"; did you mean {' or '.join(alike)}?" if alike else ""
        raise CliError(clean(f"port {port} is not registered with the name server{hint}"))
    return port


def _subscription(answer: Any) -> str:
    fields = {str(f[0]): str(f[1]) for f in answer[1:] if isinstance(f, list) and len(f) == 2}
    mode = f" [{fields['mode']}]" if "mode" in fields else ""
    return f"{fields.get('src', '?')} -> {fields.get('dest', '?')}{mode}"


def _check_accepted(answer: list[Any]) -> None:
    if answer != ["ok"]:
        raise CliError("the name server rejected the command: are both names port names, such as /robot/camera?")


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    try:
        return config.parse(f"{host.strip('[]')} {port}")
    except NamingConfigError:
        raise argparse.ArgumentTypeError(f"{text!r} is not an address: write it as 127.0.0.1:10000") from None


VERBS = {
    "where": _where,
    "name": _name,
    "list": _list,
    "exists": _exists,
    "ping": _ping,
    "connect": _connect,
    "disconnect": _disconnect,
    "clean": _clean,
}

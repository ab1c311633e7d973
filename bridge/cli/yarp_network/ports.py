"""The commands of ``midspan yarp`` that send and receive messages: read, write, rpc."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from bridge.cli.arguments import add_verb
from bridge.cli.output import CliError, json_line
from bridge.cli.yarp_network.names import add_server_arguments, client
from bridge.text import clean
from yarp_compat.interruptible import interruptible
from yarp_compat.naming import connections
from yarp_compat.ports import text_client
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import PortError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text

_WAITING = 1000
"""Maximum number of messages queued for printing; any further messages are only counted."""
_RPC_TIMEOUT = 30.0


def register(verbs: Any) -> None:
    read = add_verb(
        verbs, "read", _ended_by_signals(_read), "print the messages that a port receives",
        "Opens a port and prints the Bottles that it receives, one per line, until Ctrl-C.", hub=False,
    )  # fmt: skip
    read.add_argument("port", help="name of the port to open ('...': the name server chooses one)")
    read.add_argument("source", nargs="?", help="the port to read from; default: none, so that other ports can connect")
    read.add_argument("--carrier", default="", help="carrier of the connection: tcp (default), fast_tcp, udp, ...")
    read.add_argument("--count", type=int, metavar="N", help="exit after N messages")
    read.add_argument("--envelope", action="store_true", help="print each message's envelope (its stamp) before it")
    read.add_argument("--json", action="store_true", help="print one JSON object per line: from, envelope, text")
    write = add_verb(
        verbs, "write", _ended_by_signals(_write), "write lines as Bottles",
        "Opens a port and writes each line of standard input (or each --message) as a Bottle.",
        example="midspan yarp write ... /reader --message 'set speed 0.5'", hub=False,
    )  # fmt: skip
    write.add_argument("port", help="name of the port to open ('...': the name server chooses one)")
    write.add_argument("targets", nargs="*", metavar="target", help="ports to write to: /reader, udp://reader")
    write.add_argument("--wait", action="store_true", help="wait for a connection before the first message")
    rpc = add_verb(
        verbs, "rpc", _rpc, "send commands to a port and print its replies",
        "Sends each line of standard input (or each --message) to a port and prints the replies.",
        example="midspan yarp rpc /robot/rpc --message 'get enc 0'", hub=False,
    )  # fmt: skip
    rpc.add_argument("port", help="the port to call")
    rpc.add_argument("--admin", action="store_true", help="send administrative commands such as '[help]' to the port")
    for parser in (write, rpc):
        parser.add_argument(
            "-m", "--message", action="append", metavar="TEXT", help="a message, instead of lines from standard input"
        )
    for parser in (read, write):
        parser.add_argument(
            "--yarp4", action="store_true", help="write as YARP 4 to peers of unknown version (default: YARP 3)"
        )
        add_server_arguments(parser)
    add_server_arguments(rpc, _RPC_TIMEOUT)


def _read(args: argparse.Namespace) -> int:
    received: deque[PortMessage] = deque()
    count = threading.Semaphore(0)
    missed = 0

    def on_message(message: PortMessage) -> None:
        nonlocal missed
        if len(received) < _WAITING:
            received.append(message)
            count.release()
        else:
            missed += 1

    _check_name(args)
    names = client(args)
    port = PortCore(args.port, on_message=on_message, naming=names, is_output=False, profile=_profile(args))
    port.open()
    try:
        if args.source:
            connections.connect(names, args.source, port.name, args.carrier, timeout=args.timeout)
        else:
            print(f"{port.name} is open: connect it with 'midspan yarp connect /source {port.name}'", file=sys.stderr)
        shown = 0
        while shown < (math.inf if args.count is None else args.count):
            interruptible(lambda seconds: count.acquire(timeout=seconds))
            print(_message_text(args, received.popleft()), flush=True)
            shown += 1
    except KeyboardInterrupt:
        pass
    finally:
        port.close()
        if missed:
            print(f"{missed} messages were not shown: they arrive faster than they can be printed", file=sys.stderr)
    return 0


def _message_text(args: argparse.Namespace, message: PortMessage) -> str:
    try:
        text = to_text(decode(message.payload, message.peer.profile))
    except WireError as err:
        text = f"# {len(message.payload)} bytes that are not a Bottle: {err}"
    if args.json:
        return json_line({"from": message.peer.route.source, "envelope": message.envelope, "text": text})
    return clean(f"[{message.envelope}] {text}" if args.envelope else text)


def _write(args: argparse.Namespace) -> int:
    _check_name(args)
    names = client(args)
    port = PortCore(args.port, naming=names, is_input=False, profile=_profile(args))
    port.open()
    try:
        for target in args.targets:
            done, reply = port.add_output(target)
            if not done:
                raise CliError(clean(reply))
        while args.wait and not port.outputs():
            time.sleep(0.05)
        for line in _lines(args):
            reached = port.write(partial(encode, _values(line)), wait=True, timeout=args.timeout)
            if not reached and not args.targets:
                print("not sent, because no port is connected", file=sys.stderr)
            elif reached < len(args.targets):
                raise CliError(
                    f"{len(args.targets) - reached} of {len(args.targets)} targets did not accept the message"
                )
    except KeyboardInterrupt:
        pass
    finally:
        port.close()
    return 0


def _rpc(args: argparse.Namespace) -> int:
    contact = client(args).query(args.port)
    if contact is None:
        raise CliError(clean(f"port {args.port} is not registered with the name server"))
    for line in _lines(args):
        answer = text_client.ask(contact, _values(line), admin=args.admin, timeout=args.timeout)
        for text in answer:
            print(clean(text), flush=True)
    return 0


def _lines(args: argparse.Namespace) -> Iterator[str]:
    if args.message is not None:
        yield from args.message
        return
    for line in sys.stdin:
        if line.strip():
            yield line.rstrip("\r\n")


def _values(line: str) -> list[Any]:
    try:
        return from_text(line)
    except WireError as err:
        raise CliError(f"not a Bottle: {err}") from None


def _check_name(args: argparse.Namespace) -> None:
    """Refuse a name without a slash, as YARP does, or one in use, because the name server would reassign it."""
    if args.port and not args.port.startswith(("/", "=", "...")):  # =name and ...name: the name server adds a prefix
        raise CliError(clean(f"{args.port!r} is not a port name: YARP's names begin with a slash, as in /{args.port}"))
    if args.port != "..." and connections.exists(client(args), args.port, timeout=args.timeout):
        raise PortError(clean(f"{args.port} is in use by another program; '...' opens a port with a unique name"))


def _profile(args: argparse.Namespace) -> Profile:
    return Profile.YARP4 if args.yarp4 else Profile.YARP3


def _ended_by_signals(verb: Callable[[argparse.Namespace], int]) -> Callable[[argparse.Namespace], int]:
    """Make SIGTERM end a command as Ctrl-C does, so that its port is unregistered."""

    def run(args: argparse.Namespace) -> int:
        former = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            return verb(args)
        finally:
            signal.signal(signal.SIGTERM, former)

    return run

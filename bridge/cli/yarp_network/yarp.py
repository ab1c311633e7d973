"""``midspan yarp``: the functions of the ``yarp`` tool for machines without YARP, and a name server."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from bridge.cli.arguments import add_verb, add_verbs
from bridge.cli.output import CliError
from bridge.cli.yarp_network import names, ports
from yarp_compat.interruptible import interruptible
from yarp_compat.naming import config
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import GC_SECONDS, NameServer

_EPILOG = """\
The name server is the one in yarp.conf (which YARP's own programs use), or --server's. Options follow the command:
midspan yarp list --server 192.168.1.2:10000
"""


def register(parser: argparse.ArgumentParser) -> None:
    verbs = add_verbs(
        parser,
        "Shows, connects, reads and writes ports of a YARP network without an installed YARP; runs a name server.",
    )
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    names.register(verbs)
    ports.register(verbs)
    _register_server(verbs)


def _register_server(verbs: Any) -> None:
    parser = add_verb(
        verbs, "server", _server, "run a name server",
        "Runs a name server like yarpserver until Ctrl-C. It stores ports and persistent connections across restarts,"
        " and listens on loopback unless --host is given.", hub=False,
    )  # fmt: skip
    parser.add_argument(
        "--host", metavar="ADDRESS", help="address of this machine to listen on (default: yarp.conf's, else 127.0.0.1)"
    )
    parser.add_argument("--port", type=int, metavar="N", help=f"TCP port (default: yarp.conf's, {config.DEFAULT_PORT})")
    parser.add_argument("--write", action="store_true", help="write the address to yarp.conf, so that programs find it")
    parser.add_argument(
        "--state", type=Path, metavar="FILE", help="file of its state (default: yarp.names.json next to yarp.conf)"
    )
    parser.add_argument("--forget", action="store_true", help="store nothing across restarts")
    parser.add_argument(
        "--gc", type=float, default=GC_SECONDS, metavar="SECONDS",
        help="seconds between checks for dead ports (default %(default)g; 0: never)",
    )  # fmt: skip


def _server(args: argparse.Namespace) -> int:
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)
    given = config.read() or Address("127.0.0.1", config.DEFAULT_PORT)
    address = Address(args.host or given.host, given.port if args.port is None else args.port)
    if not 0 < address.port <= 0xFFFF:
        raise CliError("--port must be a number from 1 to 65535")
    space = config.namespace()
    state = None if args.forget else args.state or config.file().with_suffix(".names.json")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with NameServer(address.host, address.port, namespace=space, state=state, gc_seconds=args.gc):
        if args.write:
            print(f"wrote {config.write(address)}")
        elif given != address:
            print(f"programs find the server if {config.file()} has '{address.host} {address.port} yarp' (use --write)")
        print(f"{space} at {address.host} port {address.port}; web page: http://{address.host}:{address.port}/")
        sys.stdout.flush()
        interruptible(stop.wait)
    return 0

"""``midspan yarp server``: a name server, for YARP networks that have none."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from bridge.cli.errors import CliError
from yarp_compat.naming import config
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import GC_SECONDS, NameServer


def register(verbs: Any) -> None:
    """Add the parser."""
    parser = verbs.add_parser(
        "server",
        help="run a name server",
        description="Runs a name server, as 'yarpserver' is one, until Ctrl-C. It remembers ports and persistent"
        " connections over a restart. It listens on loopback unless --host says otherwise.",
    )
    parser.add_argument(
        "--host", metavar="ADDRESS", help="address of this machine to listen at (default: yarp.conf's, else 127.0.0.1)"
    )
    parser.add_argument(
        "--port", type=int, metavar="N", help=f"TCP port (default: yarp.conf's, else {config.DEFAULT_PORT})"
    )
    parser.add_argument("--write", action="store_true", help="write the address to yarp.conf, for programs to find")
    parser.add_argument(
        "--state", type=Path, metavar="FILE", help="where it remembers (default: names.json beside yarp.conf)"
    )
    parser.add_argument("--forget", action="store_true", help="remember nothing over a restart")
    parser.add_argument(
        "--gc", type=float, default=GC_SECONDS, metavar="SECONDS",
        help="how often to look for dead ports (default %(default)g; 0: never)",
    )  # fmt: skip


def _server(args: argparse.Namespace) -> int:
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)
    given = config.read() or Address("127.0.0.1", config.DEFAULT_PORT)
    address = Address(args.host or given.host, given.port if args.port is None else args.port)
    if not 0 < address.port <= 0xFFFF:
        raise CliError("--port takes a number from 1 to 65535")
    space = config.namespace()
    state = None if args.forget else args.state or config.file().with_suffix(".names.json")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with NameServer(address.host, address.port, namespace=space, state=state, gc_seconds=args.gc):
        if args.write:
            print(f"wrote {config.write(address)}")
        elif given != address:
            print(f"programs find it when {config.file()} says '{address.host} {address.port} yarp' (--write does it)")
        print(f"{space} at {address.host} port {address.port}; to be browsed at http://{address.host}:{address.port}/")
        sys.stdout.flush()
        while not stop.wait(3600):
            pass
    return 0


VERBS = {"server": _server}

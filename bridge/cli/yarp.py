"""``midspan yarp``: YARP's own tool, for machines that have no YARP."""

from __future__ import annotations

import argparse
import math
from typing import Any

from bridge.cli import yarp_names, yarp_ports, yarp_server

_VERBS = {**yarp_names.VERBS, **yarp_ports.VERBS, **yarp_server.VERBS}

_EPILOG = """\
The name server is the one of yarp.conf (where YARP's own programs find it), or --server's. Options stand behind the
verb: midspan yarp list --server 192.168.1.2:10000
"""


def register(subparsers: Any) -> None:
    """Add the verb's parser, and one for each of its own verbs."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "yarp",
        help="look at and use a YARP network, as YARP's own tool does",
        description="Looks at the ports of a YARP network, connects them, reads from them and writes to them, for"
        " machines where YARP is not installed; runs a name server.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verbs = parser.add_subparsers(dest="yarp_verb", metavar="VERB", required=True)
    for add in (yarp_names.register, yarp_ports.register, yarp_server.register):
        add(verbs)


def run(args: argparse.Namespace) -> int:
    """Run one of the verbs."""
    if not 0 < getattr(args, "timeout", 1.0) < math.inf:
        from bridge.cli.errors import CliError

        raise CliError("--timeout takes seconds, more than 0")
    return _VERBS[args.yarp_verb](args)

"""The command ``midspan``: finds the verb, imports its file, runs it, and turns errors into one line.

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done in part (`midspan import` alone), 130 interrupted.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any

from bridge.cli.verbs import VERBS

FAILED = 1
INTERRUPTED = 130


def build_parser(loaded: Iterable[str]) -> argparse.ArgumentParser:
    """The parser with all verbs; only those in ``loaded`` are imported and know their own arguments."""
    parser = argparse.ArgumentParser(
        prog="midspan",
        description="A bridge daemon for mobile robots: real topics cross between ROS 1, ROS 2 and zenoh.",
        epilog="'midspan VERB --help' tells more about each.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and end")
    parser.add_argument("--debug", action="store_true", help="show tracebacks (may stand anywhere)")
    subparsers = parser.add_subparsers(dest="verb", metavar="VERB", required=False)
    for name, verb in VERBS.items():
        if name in loaded:
            _module(name).register(subparsers)
        else:
            subparsers.add_parser(name, help=verb.help)
    return parser


def _module(verb: str) -> Any:
    module: ModuleType = importlib.import_module(VERBS[verb].module)
    return module


def _named_verb(arguments: Sequence[str]) -> list[str]:
    first = next((argument for argument in arguments if not argument.startswith("-")), "")
    return [first] if first in VERBS else []


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in arguments  # anywhere, also behind the verb
    arguments = [argument for argument in arguments if argument != "--debug"]
    try:
        parser = build_parser(_named_verb(arguments))
        args = parser.parse_args(arguments)
        if args.version:
            return _version()
        if args.verb is None:
            parser.print_help(sys.stderr)
            return 2
        return _run(args)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        # the reader of our output went away, as `| head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as err:
        if debug:
            raise
        _complain(err)
        return FAILED


def _run(args: argparse.Namespace) -> int:
    code: int = _module(args.verb).run(args)
    sys.stdout.flush()  # a reader that went away is noticed here, where it is handled
    return code


def _version() -> int:
    from importlib.metadata import PackageNotFoundError, version

    try:
        print(f"midspan {version('midspan')}")
    except PackageNotFoundError:
        print("midspan (not installed)")
    return 0


def _complain(err: Exception) -> None:
    from bridge.cli.errors import CliError
    from bridge.config.problems import ConfigError

    logging.getLogger("midspan").debug("command failed", exc_info=err)
    if isinstance(err, ConfigError):
        print(str(err), file=sys.stderr)
    elif isinstance(err, CliError | OSError | RuntimeError | TimeoutError) and str(err):
        print(f"midspan: {err}", file=sys.stderr)
    else:
        print(f"midspan: {type(err).__name__}: {err} (--debug shows where)", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())

"""Generates the man page midspan(1) from the command line's parsers: `python scripts/manual.py`.

It uses the man(7) macros. The Debian package contains it (scripts/deb.py).
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Mapping

from bridge.cli.main import VERBS, build_parser

_FILES = """.SH FILES
.TP
.I /etc/midspan/midspan.yaml
The services' configuration; \\fBmidspan config example\\fR shows every key.
.TP
.I /etc/midspan/NAME.yaml
The configuration of another daemon, the service midspan@NAME.
.TP
.I /etc/midspan/environment
The services' environment, such as ROS_MASTER_URI; NAME.environment overrides it for midspan@NAME.
.TP
.I /var/lib/midspan
The services' state: maps, places, latched messages.
.SH EXIT STATUS
0 done, 1 failed, 2 wrong usage, 3 done in part (\\fBmidspan import\\fR, \\fBmidspan config migrate\\fR),
130 ended by SIGINT (Ctrl-C), 143 by SIGTERM, 129 by SIGHUP.
"""


def page(version: str) -> str:
    """Return the whole page."""
    parser = build_parser(VERBS)
    lines = [f'.TH MIDSPAN 1 "" "Midspan {roff(version)}" "User Commands"', ".SH NAME"]
    lines += ["midspan \\- bridge daemon for mobile robots: ROS 1, ROS 2, YARP and zenoh"]
    lines += [".SH SYNOPSIS", ".B midspan", "COMMAND [ARGUMENT ...]", ".SH DESCRIPTION", roff(parser.description or "")]
    lines += [".SH OPTIONS", *_arguments(parser), ".SH VERBS"]
    for name, verb in verbs(parser).items():
        lines += _verb(f"midspan {name}", verb, VERBS[name].help)
    return "\n".join([*lines, _FILES])


def roff(text: str) -> str:
    """Escape a text, so that it contains no roff request or escape (groff(7))."""
    text = " ".join(text.split()).replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"^(?=[.'])", "\\\\&", text)


def verbs(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    """Return the subparsers of a parser, by name."""
    subparsers = [action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return subparsers[0] if subparsers else {}


def _verb(name: str, parser: argparse.ArgumentParser, help_text: str) -> Iterator[str]:
    yield f".SS {roff(name)}"
    yield roff(parser.description or f"{help_text[:1].upper()}{help_text[1:]}.")
    usage = parser.format_usage().removeprefix("usage: ")
    yield from (".PP", f".B {roff(usage)}", *_arguments(parser))
    for subverb, subparser in verbs(parser).items():
        yield from _verb(f"{name} {subverb}", subparser, _helps(parser).get(subverb, ""))


def _helps(parser: argparse.ArgumentParser) -> dict[str, str]:
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {choice.dest: choice.help or "" for action in actions for choice in action._choices_actions}


def _arguments(parser: argparse.ArgumentParser) -> Iterator[str]:
    formatter = argparse.HelpFormatter(parser.prog)
    for action in parser._actions:
        if action.help == argparse.SUPPRESS or isinstance(action, argparse._SubParsersAction | argparse._HelpAction):
            continue
        named = formatter._format_action_invocation(action)
        yield from (".TP", f".B {roff(named)}", roff(formatter._expand_help(action) if action.help else "") or "\\&")


if __name__ == "__main__":
    from bridge import __version__

    sys.stdout.write(page(__version__))

"""The parser of all commands, and the arguments that many of them share."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from typing_extensions import override

Run = Callable[[argparse.Namespace], int]

_SPAN = re.compile(r"(\d+(?:\.\d+)?)\s*(ms|s|min|m|h|)", re.IGNORECASE)
_LONGEST = 9e9
"""The longest time that an argument may give, in seconds: about the longest wait of a thread, and the year 2255."""

_NEGATIVE = re.compile(r"-\.?(\d|inf\b|nan\b)", re.IGNORECASE)
_SECONDS = {"": 1.0, "s": 1.0, "ms": 0.001, "m": 60.0, "min": 60.0, "h": 3600.0}


class VerbParser(argparse.ArgumentParser):
    """A parser that reads every word that starts like a negative number as a value: ``-1.6,0.9``, ``-2e-3``, ``-inf``.

    Before Python 3.14, argparse does so only for plain numbers such as ``-1.6``, and reports other words as unknown
    options. An option with several values also accepts the first one after ``=``: ``--points=-1.6,0.9 2,1 2,3``.
    Errors about unknown commands, choices and options name the nearest known ones.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._negative_number_matcher = _NEGATIVE

    @override
    def parse_known_args(self, args: Iterable[str] | None = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Parse as argparse does, but split each ``--option=VALUE`` of an option with several values into two words."""
        return super().parse_known_args(list(self._split(sys.argv[1:] if args is None else args)), namespace)

    @override
    def parse_args(self, args: Iterable[str] | None = None, namespace: Any = None) -> Any:
        """Parse as argparse does, but report unknown arguments as errors of the command that they were given to."""
        arguments = list(sys.argv[1:] if args is None else args)
        self._refuse_before_verb(arguments)
        parsed, unknown = self.parse_known_args(arguments, namespace)
        if unknown:
            self._of_verb(arguments)._refuse(unknown)
        return parsed

    def _refuse_before_verb(self, words: Sequence[str]) -> None:
        """Refuse a command's option that precedes the command, because argparse would read its value as the command."""
        option = words[0].partition("=")[0] if words else ""
        known = any(name.startswith(option) for name in self._option_string_actions)
        verb = next((argument for argument in words if self._of_verb([argument]) is not self), None)
        if (
            option.startswith("-")
            and not known
            and verb is not None
            and not _did_you_mean(option, self._option_string_actions)
        ):
            self.error(f"{option} belongs after the command: '{self.prog} {verb} {option} ...'")

    def _of_verb(self, words: Iterable[str]) -> VerbParser:
        """Return the parser of the command or subcommand that a command line names."""
        parser = self
        for argument in words:
            below = next((a for a in parser._actions if isinstance(a, argparse._SubParsersAction)), None)
            if below is not None and argument in below.choices:
                parser = below.choices[argument]
        return parser

    def _refuse(self, unknown: Sequence[str]) -> NoReturn:
        options = {option for option in self._option_string_actions if option.startswith("--")}
        hints = [
            _did_you_mean(argument.partition("=")[0], options) for argument in unknown if argument.startswith("--")
        ]
        self.error(f"unrecognized arguments: {' '.join(unknown)}{next(filter(None, hints), '')}")

    @override
    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse an unknown command or choice, and name similar ones."""
        if action.choices is None or value in action.choices:
            return
        known = list(map(str, action.choices))
        if not isinstance(action, argparse._SubParsersAction):
            text = f"invalid choice: {value!r} (choose from {', '.join(known)}){_did_you_mean(str(value), known)}"
            raise argparse.ArgumentError(action, text)
        described = {str(verb.dest): str(verb.help) for verb in action._choices_actions}
        hint = _did_you_mean(str(value), known, described) or "."
        raise argparse.ArgumentError(None, f"unknown command {value!r}{hint} '{self.prog} --help' lists all commands.")

    def _split(self, words: Iterable[str]) -> Iterator[str]:
        options = True
        for argument in words:
            options = options and argument != "--"
            option, equals, value = argument.partition("=")
            if options and equals and option.startswith("--") and self._takes_several(option):
                yield from (option, value)
            else:
                yield argument

    def _takes_several(self, option: str) -> bool:
        """Whether an option, which may be abbreviated, takes several values."""
        actions = {
            id(action): action
            for name, action in self._option_string_actions.items()
            if name == option or (name.startswith(option) and option not in self._option_string_actions)
        }
        nargs = next(iter(actions.values())).nargs if len(actions) == 1 else None
        return nargs in ("+", "*") or (isinstance(nargs, int) and nargs > 1)


def _did_you_mean(text: str, known: Iterable[str], described: Mapping[str, str] | None = None) -> str:
    """Return a hint such as ``. Did you mean status?``; "" if no known name is similar, or the text is very short.

    ``described`` has the help of each command; its words also suggest the command: ``echo`` suggests ``topic``.
    """
    from bridge.text import near  # needed only here

    lowered = text.lower()
    if len(lowered) < 3:
        return ""
    verbs = [verb for verb, about in (described or {}).items() if lowered in re.findall(r"\w+", about)]
    known = list(known)
    same = [name for name in known if name.lower() == lowered]
    names = list(dict.fromkeys([*same, *verbs, *near(lowered, known, 2)]))[:3]
    return f". Did you mean {', '.join(names)}?" if names else ""


def add_verb(
    verbs: Any, name: str, run: Run | None, text: str, description: str = "", *, example: str = "", hub: bool = True
) -> argparse.ArgumentParser:
    """Add a command below another one, by default with the arguments that find the hub.

    ``text`` is the line in the list of commands, and the default description.
    """
    parser: argparse.ArgumentParser = verbs.add_parser(
        name,
        help=text,
        description=description or f"{text[0].upper()}{text[1:]}.",
        epilog=f"Example: {example}" if example else None,
    )
    if run is not None:
        parser.set_defaults(run=run)
    if hub:
        add_hub_arguments(parser)
    return parser


def add_verbs(parser: argparse.ArgumentParser, description: str, metavar: str = "COMMAND", **more: Any) -> Any:
    """Describe a command that has subcommands; return the object to which the subcommands are added."""
    parser.description = description
    return parser.add_subparsers(metavar=metavar, required=True, **more)


def add_config(parser: argparse._ActionsContainer) -> None:
    """Add the argument for the configuration file."""
    parser.add_argument("-c", "--config", type=Path, metavar="FILE", help="configuration file (default: the daemon's)")


def add_hub_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments with which every command finds the hub."""
    group = parser.add_argument_group("which hub")
    add_config(group)
    group.add_argument(
        "--router",
        type=_endpoint,
        metavar="ENDPOINT",
        help="zenoh endpoint of the router, such as tcp/192.168.1.4:7447",
    )
    group.add_argument(
        "--hub-domain", type=_domain, metavar="N", help="the hub's domain id (default: the configured one)"
    )


def _endpoint(text: str) -> str:
    from bridge.config.sections.section import zenoh_endpoint  # few command lines need it

    try:
        return zenoh_endpoint(text)
    except ValueError as err:
        raise argparse.ArgumentTypeError(str(err)) from None


def _domain(text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,3}", text) or int(text) > 232:
        shown = text if re.fullmatch(r"-?[0-9]+", text) else repr(text)
        raise argparse.ArgumentTypeError(f"{shown} is not a domain from 0 to 232")
    return int(text)


def add_exclude(parser: argparse._ActionsContainer) -> None:
    """Add ``--exclude``, which all commands that select topics have."""
    parser.add_argument(
        "-x", "--exclude", action="append", default=[], type=expression, metavar="RE",
        help="leave out topics whose names contain a match of this regular expression; may be repeated",
    )  # fmt: skip


def expression(text: str) -> str:
    """Check a regular expression; the type of an argument."""
    try:
        re.compile(text)
    except re.error as err:
        raise argparse.ArgumentTypeError(f"{text!r} is not a regular expression: {err}") from None
    return text


def span(text: str) -> float:
    """Parse a time such as ``10m``, ``90s``, ``1.5h`` or ``30`` (seconds); the type of an argument."""
    match = _SPAN.fullmatch(text.strip())
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time: write it as 30s, 10m or 1h")
    seconds = float(match[1]) * _SECONDS[match[2].lower()]
    if seconds > _LONGEST:
        raise argparse.ArgumentTypeError(f"{text[:40]} is too long: {_LONGEST:g} seconds at most")
    return seconds


def number_in(least: float, most: float) -> Callable[[str], float]:
    """Return the type of an argument that accepts a number above 0 and within these limits."""
    limits = f"between {least:g} and {most:g}" if least > 0 else f"above 0 and at most {most:g}"

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not (value > 0 and least <= value <= most):
            raise argparse.ArgumentTypeError(f"{text} is not {limits}")
        return value

    return read


seconds = number_in(0, _LONGEST)
"""Parse a time above 0, in seconds; the type of an argument."""

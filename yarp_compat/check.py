"""``python -m yarp_compat --check script.py folder``: which names of YARP scripts use that are not here.

Prints them with their lines, and what there is instead. The end is 0 where every script finds every name, else 1.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from yarp_compat import absences, catalogue
from yarp_compat.dev.drivers import registry
from yarp_compat.script_names import ScriptError, read

USAGE = "usage: python -m yarp_compat --check script.py [folder ...]"
_LEFT_OUT = {"__pycache__", "node_modules", "site-packages"}


@dataclass
class Absent:
    """A name that is not here, the lines where it is used, and what is said of it."""

    name: str
    said: str
    lines: list[int] = field(default_factory=list)


@dataclass
class Checked:
    """A script: whether it uses YARP, how many names of it, and which of them are not here."""

    path: Path
    imports_yarp: bool
    count: int = 0
    absent: list[Absent] = field(default_factory=list)

    def __str__(self) -> str:
        if not self.imports_yarp:
            return f"{self.path}: it does not import yarp"
        lines = [f"{self.path}: {_counted(self.count, 'name')} of YARP, {len(self.absent) or 'none'} missing"]
        for one in self.absent:
            where = f"line{'s' * (len(one.lines) > 1)} {', '.join(map(str, one.lines))}"
            lines.append(f"  {one.name} ({where}): {one.said}")
        return "\n".join(lines)


def check(path: Path) -> Checked:
    """Look at a script; raises `ScriptError` for a file that is none."""
    names = read(path)
    absent: dict[str, Absent] = {}
    for use in names.uses:
        shown, said = _device(use.name) if use.is_device else lacking(use.name)
        if said:
            one = absent.setdefault(shown, Absent(shown, said))
            one.lines += [use.line] * (use.line not in one.lines)
    return Checked(path, names.imports_yarp, len({use.name for use in names.uses}), list(absent.values()))


def lacking(name: str) -> tuple[str, str]:
    """What of a name (``Bottle``) or a method (``Bottle.get``) is not here, and what is said of that; or empty texts.

    Of a method whose class is not here, that is the class.
    """
    owner, _, method = name.partition(".")
    try:
        found = catalogue.find(owner)
    except AttributeError as error:
        return owner, re.sub(r"^.*? has no '\w+'[:,] ", "", str(error))
    if not method or not isinstance(found, type) or hasattr(found, method) or method in _fields(found):
        return "", ""
    return name, _missing(found, name, method)


def paths(asked: Iterable[str]) -> Iterator[Path]:
    """The files, and the Python files in folders; raises `ScriptError` for what is not there."""
    for one in map(Path, asked):
        if one.is_dir():
            found = [path for path in sorted(one.rglob("*.py")) if not _LEFT_OUT.intersection(path.parts)]
            if not found:
                raise ScriptError(f"{one}: there is no Python file in this folder")
            yield from found
        elif one.exists():
            yield one
        else:
            raise ScriptError(f"{one}: there is no such file or folder")


def main(asked: Sequence[str]) -> int:
    """Check files and folders, and print what is found; the program's end."""
    if not asked or any(one.startswith("-") for one in asked):
        sys.stderr.write(f"{USAGE}\n")
        return 1
    checked: list[Checked] = []
    wrong = 0
    for one in asked:
        try:
            for path in paths([one]):
                wrong += not _checked(path, checked)
        except ScriptError as error:
            sys.stderr.write(f"{error}\n")
            wrong += 1
    named = {Path(one) for one in asked}
    for script in checked:
        if script.imports_yarp or script.path in named:
            sys.stdout.write(f"{script}\n")
    scripts = [script for script in checked if script.imports_yarp]
    whole = sum(not script.absent for script in scripts)
    sys.stdout.write(f"{_counted(len(scripts), 'script')} for YARP, {whole} with every name\n")
    return int(bool(wrong) or whole < len(scripts))


def _checked(path: Path, into: list[Checked]) -> bool:
    """Check one file, and keep what was found; whether it could be read."""
    try:
        into.append(check(path))
    except ScriptError as error:
        sys.stderr.write(f"{error}\n")
        return False
    return True


def _device(name: str) -> tuple[str, str]:
    """A device that is not here, and what is said of it; empty texts where it is."""
    try:
        registry.factory(name)
    except registry.DeviceError as error:
        return f"device {name}", re.sub(r"^there is no device '\w+' here; ", "", str(error))
    return "", ""


def _fields(kind: type) -> set[str]:
    """What only objects of a class have: a structure's fields, a pixel's channels."""
    fields = {one.name for one in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    return fields | set(getattr(kind, "names", ()))


def _missing(kind: type, name: str, method: str) -> str:
    """What is said of a method that a class does not have: a slip of the pen is more likely than what YARP has too."""
    import difflib

    own = [name for name in dir(kind) if not name.startswith("_")]
    slip, close = difflib.get_close_matches(method, own, 1, 0.85), difflib.get_close_matches(method, own, 3)
    if slip:
        return f"did you mean {slip[0]!r}?"
    return absences.instead(name) or (f"there is {', '.join(close)}" if close else absences.DOCUMENTED)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"

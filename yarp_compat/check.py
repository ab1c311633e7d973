"""``python -m yarp_compat --check script.py folder``: list names of YARP that scripts use, but this package lacks.

The names are printed with their lines and replacements. The exit code is 0 if all scripts can be read and use no
missing names, else 1.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from yarp_compat import absences, catalog
from yarp_compat.dev.drivers import registry
from yarp_compat.overriding import override
from yarp_compat.script_names import ScriptError, read

USAGE = "usage: python -m yarp_compat --check script.py [folder ...]"
_SKIPPED = {"__pycache__", "node_modules", "site-packages"}


@dataclass
class MissingName:
    """A name that this package lacks, the reason, and the lines that use it."""

    name: str
    reason: str
    lines: list[int] = field(default_factory=list)


@dataclass
class ScriptReport:
    """The result of checking a script: whether it imports YARP, how many YARP names it uses, and which are missing."""

    path: Path
    imports_yarp: bool
    count: int = 0
    missing: list[MissingName] = field(default_factory=list)

    @override
    def __str__(self) -> str:
        if not self.imports_yarp:
            return f"{self.path}: it does not import yarp"
        lines = [f"{self.path}: {_counted(self.count, 'name')} of YARP, {len(self.missing) or 'none'} missing"]
        for entry in self.missing:
            numbers = f"line{'s' * (len(entry.lines) > 1)} {', '.join(map(str, entry.lines))}"
            lines.append(f"  {entry.name} ({numbers}): {entry.reason}")
        return "\n".join(lines)


def check(path: Path) -> ScriptReport:
    """Check a script; raises `ScriptError` if the file is not a readable Python script."""
    names = read(path)
    missing: dict[str, MissingName] = {}
    for use in names.uses:
        shown, reason = _device(use.name) if use.is_device else lacking(use.name)
        if reason:
            entry = missing.setdefault(shown, MissingName(shown, reason))
            entry.lines += [use.line] * (use.line not in entry.lines)
    return ScriptReport(path, names.imports_yarp, len({use.name for use in names.uses}), list(missing.values()))


def lacking(name: str) -> tuple[str, str]:
    """Return what is missing of a class (``Bottle``) or method (``Bottle.get``), and the reason; both "" if nothing is.

    For a method of a missing class, the class is what is missing.
    """
    owner, _, method = name.partition(".")
    try:
        named = catalog.find(owner)
    except AttributeError as error:
        return owner, re.sub(r"^.*? has no '\w+'[:,] ", "", str(error))
    if not method or not isinstance(named, type) or hasattr(named, method) or method in _fields(named):
        return "", ""
    return name, _missing(named, name, method)


def paths(arguments: Iterable[str]) -> Iterator[Path]:
    """Yield the files, and the Python files in folders; raises `ScriptError` for a missing file or empty folder."""
    for argument in map(Path, arguments):
        if argument.is_dir():
            files = [path for path in sorted(argument.rglob("*.py")) if not _SKIPPED.intersection(path.parts)]
            if not files:
                raise ScriptError(f"{argument}: no Python files in this folder")
            yield from files
        elif argument.exists():
            yield argument
        else:
            raise ScriptError(f"{argument}: file or folder not found")


def main(arguments: Sequence[str]) -> int:
    """Check files and folders, and print the results; return the exit code."""
    if not arguments or any(argument.startswith("-") for argument in arguments):
        sys.stderr.write(f"{USAGE}\n")
        return 1
    reports: list[ScriptReport] = []
    failures = 0
    for argument in arguments:
        try:
            for path in paths([argument]):
                failures += not _check_file(path, reports)
        except ScriptError as error:
            sys.stderr.write(f"{error}\n")
            failures += 1
    named = {Path(argument) for argument in arguments}
    for script in reports:
        if script.imports_yarp or script.path in named:
            sys.stdout.write(f"{script}\n")
    scripts = [script for script in reports if script.imports_yarp]
    complete = sum(not script.missing for script in scripts)
    sys.stdout.write(f"{_counted(len(scripts), 'script')} for YARP, {complete} with every name\n")
    return int(bool(failures) or complete < len(scripts))


def _check_file(path: Path, reports: list[ScriptReport]) -> bool:
    """Check one file, and add its report to ``reports``; return whether it could be read."""
    try:
        reports.append(check(path))
    except ScriptError as error:
        sys.stderr.write(f"{error}\n")
        return False
    return True


def _device(name: str) -> tuple[str, str]:
    """Return ``device NAME`` and the reason if this package lacks a device, else two empty texts."""
    try:
        registry.factory(name)
    except registry.DeviceError as error:
        return f"device {name}", re.sub(r"^unknown device '\w+'; ", "", str(error))
    return "", ""


def _fields(kind: type) -> set[str]:
    """Return the attributes that only objects of a class have: a structure's fields, a pixel's channels."""
    fields = {item.name for item in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    return fields | set(getattr(kind, "names", ()))


def _missing(kind: type, name: str, method: str) -> str:
    """Return the reason for a missing method: a very similar name, else why the method is absent."""
    import difflib

    methods = [name for name in dir(kind) if not name.startswith("_")]
    typo, close = difflib.get_close_matches(method, methods, 1, 0.85), difflib.get_close_matches(method, methods, 3)
    if typo:
        return f"did you mean {typo[0]!r}?"
    return absences.instead(name) or (f"similar names are {', '.join(close)}" if close else absences.DOCUMENTED)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"

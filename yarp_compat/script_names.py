"""Finds the names of YARP that a Python script uses, from its syntax tree, without running the script.

These are names of the module (``yarp.Bottle``, ``from yarp import Bottle``), methods of variables with one class in
their function (``port = yarp.Port()``, ``self.port = ...``, ``motors = driver.viewIEncoders()``), and names of devices
(``options.put("device", "grabber")``).
"""

from __future__ import annotations

import ast
import builtins
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_MODULES = ("yarp", "yarp_compat")
_DEVICE = re.compile(r"\(\s*device\s+\"?([A-Za-z]\w*)")
_VIEW = re.compile(r"view(I[A-Z]\w*)")
_PYTHON_2 = re.compile(
    r"""^\s*print\b\s*[^\s(=]|^\s*except\s.*,\s*\w+\s*:|^\s*raise\s+[\w.]+\s*,|^\s*exec\s+\S|<>|`|\bur["']"""
    r"""|\b0[0-7]+\b|\b\d+L\b|lambda\s*\(|def\s+\w+\(.*\(\w+,"""
)
"""A line with a syntax error in Python 3 that is valid in Python 2."""


class ScriptError(Exception):
    """Raised if a file cannot be read as a script; the message gives the file, line and reason."""


@dataclass(frozen=True, order=True)
class NameUse:
    """A name that a script uses: ``Bottle``, ``Bottle.get``, or with ``is_device`` the name of a device."""

    line: int
    name: str
    is_device: bool = False


@dataclass(frozen=True)
class ScriptNames:
    """The names that a script uses, and whether it imports YARP."""

    imports_yarp: bool
    uses: tuple[NameUse, ...]


def read(path: Path) -> ScriptNames:
    """Return the names that a file uses; raises `ScriptError`."""
    try:
        content = path.read_bytes()
        text = content.decode(tokenize.detect_encoding(io.BytesIO(content).readline)[0])
    except (OSError, SyntaxError, LookupError, UnicodeDecodeError) as error:
        raise ScriptError(f"{path}: cannot read it as Python: {error}") from None
    try:
        tree = ast.parse(text)
    except SyntaxError as error:
        line = (text.splitlines()[(error.lineno or 1) - 1 :] or [""])[0]
        reason = (
            "this is Python 2: convert it first, with 2to3 or by hand"
            if _PYTHON_2.search(line)
            else _invalid(error.msg)
        )
        raise ScriptError(f"{path}:{error.lineno or 1}: {reason}") from None
    except (ValueError, RecursionError, MemoryError) as error:  # a zero byte, or too many brackets
        raise ScriptError(f"{path}: {_invalid(error)}") from None
    return names_of(tree)


def _invalid(reason: object) -> str:
    return f"not valid Python: {reason}"


def names_of(tree: ast.Module) -> ScriptNames:
    """Return the names that a script's tree uses, in order of lines."""
    imports = _Imports(tree)
    if not (imports.modules or imports.names or imports.star):
        return ScriptNames(imports_yarp=False, uses=())
    uses = {*_Uses(tree, imports).uses, *_devices(tree)}
    return ScriptNames(imports_yarp=True, uses=tuple(sorted(uses)))


class _Imports:
    """The names in a script that are imported from YARP."""

    def __init__(self, tree: ast.Module) -> None:
        self.modules: set[str] = set()
        self.names: dict[str, str] = {}
        self.star = False
        self.lines: dict[str, int] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                self.modules |= {alias.asname or alias.name for alias in node.names if alias.name in _MODULES}
            elif isinstance(node, ast.ImportFrom) and node.module in _MODULES and not node.level:
                for alias in node.names:
                    self.star = self.star or alias.name == "*"
                    self.names[alias.asname or alias.name] = alias.name
                    self.lines.setdefault(alias.name, node.lineno)
        self.names.pop("*", None)
        self.lines.pop("*", None)

    def name(self, node: ast.expr) -> str:
        """Return the name of YARP that an expression refers to, "" if none."""
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in self.modules:
            return node.attr
        return self.names.get(node.id, "") if isinstance(node, ast.Name) else ""


_Scope = tuple[ast.AST, ...]


class _Uses:
    """All uses in a tree. A variable has a class if all assignments in its function create objects of that class."""

    def __init__(self, tree: ast.Module, imports: _Imports) -> None:
        self._imports = imports
        self._kinds: dict[tuple[ast.AST, str], set[str]] = defaultdict(set)
        self._scopes = list(_scopes(tree, (tree,)))
        if imports.star:
            imports.names |= {name: name for name in _unbound(tree)}
        for node, scope in self._scopes:
            self._collect_assignments(node, scope)
        self.uses = {NameUse(line, name) for name, line in imports.lines.items()}
        for node, scope in self._scopes:
            self._collect_uses(node, scope)

    def _collect_assignments(self, node: ast.AST, scope: _Scope) -> None:
        if isinstance(node, ast.Assign):
            for target in node.targets:
                self._assign(target, node.value, scope)
        elif isinstance(node, (ast.AnnAssign, ast.NamedExpr)):
            self._assign(node.target, node.value, scope)
        elif isinstance(node, ast.withitem) and node.optional_vars is not None:
            self._assign(node.optional_vars, node.context_expr, scope)
        elif isinstance(node, (ast.For, ast.AugAssign, ast.comprehension)):
            self._assign(node.target, None, scope)
        elif isinstance(node, ast.arg):
            self._kinds[scope[-1], node.arg].add("")

    def _assign(self, target: ast.expr, value: ast.expr | None, scope: _Scope) -> None:
        if isinstance(target, (ast.Tuple, ast.List)):
            values = value.elts if isinstance(value, (ast.Tuple, ast.List)) else []
            paired = values if len(values) == len(target.elts) else [None] * len(target.elts)
            for element, assigned in zip(target.elts, paired, strict=True):
                self._assign(element, assigned, scope)
            return
        key = _key(target, scope)
        if key is not None and not (isinstance(value, ast.Constant) and value.value is None):
            self._kinds[key].add(self._class_of(value))

    def _class_of(self, value: ast.expr | None) -> str:
        """Return the class of the object that an expression creates, "" if unknown."""
        if not isinstance(value, ast.Call):
            return ""
        view = isinstance(value.func, ast.Attribute) and _VIEW.fullmatch(value.func.attr)
        return view[1] if view else self._imports.name(value.func)

    def _collect_uses(self, node: ast.AST, scope: _Scope) -> None:
        if isinstance(node, (ast.Attribute, ast.Name)) and isinstance(node.ctx, ast.Load):
            name = self._imports.name(node)
            if name:
                self.uses.add(NameUse(node.lineno, name))
        if isinstance(node, ast.Attribute):
            owner = self._imports.name(node.value)
            if owner and owner[:1].isupper():
                self.uses.add(NameUse(node.lineno, f"{owner}.{node.attr}"))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            kind = self._class_of(node.func.value) or self._kind(node.func.value, scope)
            if kind[:1].isupper():
                self.uses.add(NameUse(node.lineno, f"{kind}.{node.func.attr}"))

    def _kind(self, node: ast.expr, scope: _Scope) -> str:
        """Return the class of a variable, "" if it is unknown or not unique."""
        while scope:
            key = _key(node, scope)
            kinds = self._kinds.get(key, set()) if key is not None else set()
            if kinds:
                return next(iter(kinds)) if len(kinds) == 1 else ""
            scope = scope[:-1]
        return ""


def _scopes(node: ast.AST, scope: _Scope) -> Iterator[tuple[ast.AST, _Scope]]:
    """Yield each node with the module, classes and functions around it."""
    for child in ast.iter_child_nodes(node):
        opens = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda))
        yield child, scope
        yield from _scopes(child, (*scope, child) if opens else scope)


def _key(target: ast.expr, scope: _Scope) -> tuple[ast.AST, str] | None:
    """Return the identity of a variable: its function and name, or for an attribute of ``self``, its class and name."""
    if isinstance(target, ast.Name):
        return scope[-1], target.id
    if isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id == "self":
        owner = next((node for node in reversed(scope) if isinstance(node, ast.ClassDef)), None)
        return None if owner is None else (owner, f"self.{target.attr}")
    return None


def _unbound(tree: ast.Module) -> set[str]:
    """Return the names that a script uses and does not bind, which ``from yarp import *`` must provide."""
    used, bound = set[str](), {*dir(builtins), "__file__", "__name__", "__doc__"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            (used if isinstance(node.ctx, ast.Load) else bound).add(node.id)
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            bound.add(node.name)
        elif isinstance(node, ast.arg):
            bound.add(node.arg)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            bound |= {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ExceptHandler) and node.name:
            bound.add(node.name)
    return used - bound


def _devices(tree: ast.Module) -> Iterator[NameUse]:
    """Yield the devices that a script opens by a literal name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            values = [argument.value if isinstance(argument, ast.Constant) else None for argument in node.args]
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called == "put" and len(values) == 2 and values[0] == "device" and isinstance(values[1], str):
                yield NameUse(node.lineno, values[1], is_device=True)
            elif called in ("PolyDriver", "open_str") and len(values) == 1 and isinstance(values[0], str):
                yield NameUse(node.lineno, values[0], is_device=True)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            for match in _DEVICE.finditer(node.value):
                yield NameUse(node.lineno, match[1], is_device=True)

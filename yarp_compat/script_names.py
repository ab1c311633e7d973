"""The names of YARP that a Python script uses, by its syntax tree; the script is not run.

Found are names of the module (``yarp.Bottle``, ``from yarp import Bottle``), methods of variables that are made of one
class alone in their function (``port = yarp.Port()``, ``self.port = ...``, ``motors = driver.viewIEncoders()``), and
the names of devices (``options.put("device", "grabber")``).
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
"""A line at which Python 3 stops, and Python 2 does not."""


class ScriptError(Exception):
    """A file is no script that can be read; the message says which, where and why."""


@dataclass(frozen=True, order=True)
class NameUse:
    """A name that a script uses: ``Bottle``, ``Bottle.get``; or a device's, which ``is_device``."""

    line: int
    name: str
    is_device: bool = False


@dataclass(frozen=True)
class ScriptNames:
    """What a script uses; it may be no script for YARP at all."""

    imports_yarp: bool
    uses: tuple[NameUse, ...]


def read(path: Path) -> ScriptNames:
    """The names that a file uses; raises `ScriptError`."""
    try:
        content = path.read_bytes()
        text = content.decode(tokenize.detect_encoding(io.BytesIO(content).readline)[0])
    except (OSError, SyntaxError, LookupError, UnicodeDecodeError) as error:
        raise ScriptError(f"{path}: it cannot be read as Python: {error}") from None
    try:
        tree = ast.parse(text)
    except SyntaxError as error:
        line = (text.splitlines()[(error.lineno or 1) - 1 :] or [""])[0]
        said = "it is Python 2: convert it first, by 2to3 or by hand" if _PYTHON_2.search(line) else _no(error.msg)
        raise ScriptError(f"{path}:{error.lineno or 1}: {said}") from None
    except (ValueError, RecursionError, MemoryError) as error:  # a zero byte, or brackets without end
        raise ScriptError(f"{path}: {_no(error)}") from None
    return names_of(tree)


def _no(why: object) -> str:
    return f"it is no Python: {why}"


def names_of(tree: ast.Module) -> ScriptNames:
    """The names that a script's tree uses, in the order of lines."""
    found = _Imports(tree)
    if not (found.modules or found.names or found.star):
        return ScriptNames(imports_yarp=False, uses=())
    uses = {*_Uses(tree, found).found, *_devices(tree)}
    return ScriptNames(imports_yarp=True, uses=tuple(sorted(uses)))


class _Imports:
    """What names of the script are YARP's."""

    def __init__(self, tree: ast.Module) -> None:
        self.modules: set[str] = set()
        self.names: dict[str, str] = {}
        self.star = False
        self.lines: dict[str, int] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                self.modules |= {one.asname or one.name for one in node.names if one.name in _MODULES}
            elif isinstance(node, ast.ImportFrom) and node.module in _MODULES and not node.level:
                for one in node.names:
                    self.star = self.star or one.name == "*"
                    self.names[one.asname or one.name] = one.name
                    self.lines.setdefault(one.name, node.lineno)
        self.names.pop("*", None)
        self.lines.pop("*", None)

    def name(self, node: ast.expr) -> str:
        """The name of YARP that an expression is; empty where it is none."""
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in self.modules:
            return node.attr
        return self.names.get(node.id, "") if isinstance(node, ast.Name) else ""


_Scope = tuple[ast.AST, ...]


class _Uses:
    """All uses in a tree. A variable has a class where all that is assigned to it in its function is made of that."""

    def __init__(self, tree: ast.Module, imports: _Imports) -> None:
        self._imports = imports
        self._kinds: dict[tuple[ast.AST, str], set[str]] = defaultdict(set)
        self._scopes = list(_scopes(tree, (tree,)))
        if imports.star:
            imports.names |= {name: name for name in _unbound(tree)}
        for node, scope in self._scopes:
            self._learn(node, scope)
        self.found = {NameUse(line, name) for name, line in imports.lines.items()}
        for node, scope in self._scopes:
            self._see(node, scope)

    def _learn(self, node: ast.AST, scope: _Scope) -> None:
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
            for one, its in zip(target.elts, paired, strict=True):
                self._assign(one, its, scope)
            return
        key = _key(target, scope)
        if key is not None and not (isinstance(value, ast.Constant) and value.value is None):
            self._kinds[key].add(self._made(value))

    def _made(self, value: ast.expr | None) -> str:
        """The class of what an expression makes; empty where that is not known."""
        if not isinstance(value, ast.Call):
            return ""
        view = isinstance(value.func, ast.Attribute) and _VIEW.fullmatch(value.func.attr)
        return view[1] if view else self._imports.name(value.func)

    def _see(self, node: ast.AST, scope: _Scope) -> None:
        if isinstance(node, (ast.Attribute, ast.Name)) and isinstance(node.ctx, ast.Load):
            name = self._imports.name(node)
            if name:
                self.found.add(NameUse(node.lineno, name))
        if isinstance(node, ast.Attribute):
            owner = self._imports.name(node.value)
            if owner and owner[:1].isupper():
                self.found.add(NameUse(node.lineno, f"{owner}.{node.attr}"))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            made = self._made(node.func.value) or self._kind(node.func.value, scope)
            if made[:1].isupper():
                self.found.add(NameUse(node.lineno, f"{made}.{node.func.attr}"))

    def _kind(self, node: ast.expr, scope: _Scope) -> str:
        """The class of a variable; empty where it is not known, or there are several."""
        while scope:
            key = _key(node, scope)
            kinds = self._kinds.get(key, set()) if key is not None else set()
            if kinds:
                return next(iter(kinds)) if len(kinds) == 1 else ""
            scope = scope[:-1]
        return ""


def _scopes(node: ast.AST, scope: _Scope) -> Iterator[tuple[ast.AST, _Scope]]:
    """Each node, and the module, classes and functions that it is in."""
    for child in ast.iter_child_nodes(node):
        own = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda))
        yield child, scope
        yield from _scopes(child, (*scope, child) if own else scope)


def _key(target: ast.expr, scope: _Scope) -> tuple[ast.AST, str] | None:
    """What tells a variable from others of its name: its function; of an attribute of ``self``, its class."""
    if isinstance(target, ast.Name):
        return scope[-1], target.id
    if isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id == "self":
        owner = next((one for one in reversed(scope) if isinstance(one, ast.ClassDef)), None)
        return None if owner is None else (owner, f"self.{target.attr}")
    return None


def _unbound(tree: ast.Module) -> set[str]:
    """The names that a script uses and does not make: those that ``from yarp import *`` has to give."""
    used, made = set[str](), {*dir(builtins), "__file__", "__name__", "__doc__"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            (used if isinstance(node.ctx, ast.Load) else made).add(node.id)
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            made.add(node.name)
        elif isinstance(node, ast.arg):
            made.add(node.arg)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            made |= {(one.asname or one.name).partition(".")[0] for one in node.names}
        elif isinstance(node, ast.ExceptHandler) and node.name:
            made.add(node.name)
    return used - made


def _devices(tree: ast.Module) -> Iterator[NameUse]:
    """The devices that a script opens by names that stand in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            words = [one.value if isinstance(one, ast.Constant) else None for one in node.args]
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called == "put" and len(words) == 2 and words[0] == "device" and isinstance(words[1], str):
                yield NameUse(node.lineno, words[1], is_device=True)
            elif called in ("PolyDriver", "open_str") and len(words) == 1 and isinstance(words[0], str):
                yield NameUse(node.lineno, words[0], is_device=True)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            for found in _DEVICE.finditer(node.value):
                yield NameUse(node.lineno, found[1], is_device=True)

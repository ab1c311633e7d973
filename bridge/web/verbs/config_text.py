"""The configuration as pages see it: the file's text with its comments, without secrets."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from bridge.config.document import ConfigError, Problem, Yaml12Loader, text_of
from bridge.config.generate import example
from bridge.config.load import find, loads
from bridge.config.model import Config
from bridge.daemon.query import ask_daemon

HIDDEN = "(hidden)"

_NAME = r"passw|passphrase|pwd|secret|token|credential|private|api_?key|access_?key|_base64"
_SECRET = re.compile(_NAME, re.IGNORECASE)
_COMMENT = re.compile(rf"(#[^\n]*?(?:{_NAME})[\w-]*[\"']?\s*[:=]\s*)([^\s#][^\n]*)", re.IGNORECASE)
_USER = re.compile(r"(//)[^/\s:@]+:[^/\s@]+(@)")
_PEM = re.compile(r"-----BEGIN [^-]*-----.*?(?:-----END [^-]*-----|\Z)", re.DOTALL)
_DAEMON_SECONDS = 5.0
_SHORTEST = 8
"""Minimum length of a secret that is hidden wherever it appears; a shorter secret is hidden only in its own key."""


class Secrets(NamedTuple):
    """The secrets of a configuration: their positions in the text, and their values."""

    places: tuple[tuple[int, int], ...] = ()
    values: tuple[str, ...] = ()

    def hide(self, text: str) -> str:
        """Return a text about the configuration, without its secrets."""
        for value in self.values:
            text = text.replace(value, HIDDEN)
        return _PEM.sub(HIDDEN, _USER.sub(rf"\g<1>{HIDDEN}\g<2>", text))


def secrets_of(text: str) -> Secrets:
    """Return the secrets of a YAML text, all values below a secret key. Raises `yaml.YAMLError`, `RecursionError`."""
    root = Yaml12Loader(text).get_single_node()
    places: set[tuple[int, int]] = set()
    values: set[str] = set()
    for node in _secret(root, under=False, seen=set()) if root is not None else ():
        start, end = node.start_mark.index, node.end_mark.index
        places.add((start, start + len(text[start:end].rstrip())))
        values.add(node.value)
    long_enough = (value for value in values if len(value) >= _SHORTEST)
    return Secrets(tuple(sorted(places)), tuple(sorted(long_enough, key=len, reverse=True)))


def _secret(node: Node, *, under: bool, seen: set[tuple[int, bool]]) -> Iterator[ScalarNode]:
    if (id(node), under) in seen:  # an alias of a visited node
        return
    seen.add((id(node), under))
    match node:
        case MappingNode():
            for key, child in node.value:
                if under:
                    yield from _secret(key, under=True, seen=seen)
                named = isinstance(key, ScalarNode) and _SECRET.search(key.value) is not None
                yield from _secret(child, under=under or named, seen=seen)
        case SequenceNode():
            for child in node.value:
                yield from _secret(child, under=under, seen=seen)
        case ScalarNode() if under:
            yield node


def without_secrets(text: str, secrets: Secrets) -> str:
    """Return a configuration's text, with each secret replaced by `HIDDEN`."""
    parts, at = [], 0
    for start, end in secrets.places:
        parts += [text[at:start], HIDDEN] if start >= at else []
        at = max(at, end)
    shown = "".join([*parts, text[at:]])
    return _COMMENT.sub(rf"\g<1>{HIDDEN}", secrets.hide(shown))


def config_file(config: Config) -> Path | None:
    """Return the file of the daemon's configuration; None if it has none."""
    daemon = ask_daemon(config, _DAEMON_SECONDS)
    return Path(daemon.config) if daemon is not None and daemon.config else find()


def show_config(config: Config) -> dict[str, Any]:
    """Return the value of the verb ``config``: the file, its text without secrets, the findings of ``config check``."""
    file = config_file(config)
    if file is None:
        return {"file": None, "text": example(), "why": "", "problems": []}
    text = reason = ""
    problems: tuple[Problem, ...] = ()
    secrets = Secrets()
    try:
        text = text_of(file)
        secrets = secrets_of(text)
        loads(text, file)
    except ConfigError as err:
        problems = err.problems
        reason = "" if text else str(err)
    except (yaml.YAMLError, RecursionError):
        text, problems = "", _no_yaml(text, file)
        reason = "The file is not shown: it is not valid YAML, so its secrets cannot be recognized."
    return {
        "file": str(file),
        "text": without_secrets(text, secrets) if text else None,
        "why": reason,
        "problems": [_problem(problem, secrets) for problem in problems],
    }


def _no_yaml(text: str, file: Path) -> tuple[Problem, ...]:
    try:
        loads(text, file)
    except ConfigError as err:
        return err.problems
    return ()


def _problem(problem: Problem, secrets: Secrets) -> dict[str, Any]:
    text = secrets.hide(problem.text)
    if _SECRET.search(problem.key):
        text = f"is invalid; run 'midspan config check {problem.file}' on the machine for the reason"
    return {**dataclasses.asdict(problem), "file": str(problem.file), "text": text}

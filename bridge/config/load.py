"""Loads a YAML file into a checked `Config`, or raises the list of all its problems."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from bridge.config.digests import digest_of
from bridge.config.document import ConfigError, Document, KeyPath, Problem, parse, read
from bridge.config.listeners import listener_problems
from bridge.config.migrate import too_new
from bridge.config.model import Config
from bridge.config.problems import key_name, model_of, problems
from bridge.config.rules import untyped
from bridge.config.sections.section import Section
from bridge.config.zenoh_settings import zenoh_problems

Config.model_rebuild()  # imports the models of all sections

# paths that need not exist, because Midspan creates them
CREATED_PATHS: frozenset[KeyPath] = frozenset({("state",), ("record", "folder")})

_FOLDERS = frozenset({"state", "folder", "folders", "keys", "packages"})
"""The names of keys whose paths are folders; all other paths are files."""


def find(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the file to use if the caller names none; None to use the defaults.

    It is ``$MIDSPAN_CONFIG`` if that is set, even if the file does not exist; otherwise the first existing file of
    ``./midspan.yaml``, ``$XDG_CONFIG_HOME/midspan/midspan.yaml`` (by default ``~/.config``) and
    ``/etc/midspan/midspan.yaml``.
    """
    named = environ.get("MIDSPAN_CONFIG")
    if named:
        return Path(named)
    home = Path(environ.get("XDG_CONFIG_HOME") or Path(environ.get("HOME") or Path.home()) / ".config")
    for file in (Path("midspan.yaml"), home / "midspan" / "midspan.yaml", Path("/etc/midspan/midspan.yaml")):
        with suppress(OSError):  # this user may not look into the folder, such as root's after runuser
            if file.is_file():
                return file
    return None


def load(path: Path | None = None, *, client: bool = False) -> Config:
    """Load a file, by default the one that `find` finds; raises `ConfigError` with all its problems.

    For a ``client`` of the hub, it skips the checks of what only the daemon's workers use, such as the simulation's
    plan: they import libraries and read files.
    """
    file = path if path is not None else find()
    return Config() if file is None else from_document(read(file), client=client)


def loads(text: str, file: Path = Path("<text>")) -> Config:
    """Load a text as if it were the file ``file``; see `load`."""
    return from_document(parse(file, text))


def from_document(document: Document, *, client: bool = False) -> Config:
    """Return the configuration in a document; see `load`."""
    data = {} if document.data is None else document.data
    if not isinstance(data, dict):
        raise ConfigError([document.problem((), "must be a map of sections, for example 'hub:'")])
    if newer := too_new(document):
        raise ConfigError([newer])
    try:
        config = Config.model_validate(_without_empty(data, Config))
    except ValidationError as err:
        raise ConfigError(problems(document, Config, err.errors(include_url=False))) from err
    if config.hub.open.opened and (vague := untyped(config.routing)):
        raise ConfigError([document.problem(("routing", "rules", rule.index), rule.text) for rule in vague])
    if twice := listener_problems(document, config):
        raise ConfigError(twice)
    missing: list[Problem] = []
    placed: Config = _resolve_paths(config, (), document, missing)
    if missing:
        raise ConfigError(missing)
    sections = () if client else tuple(_enabled_sections(placed, ()))
    wrong = [((*place, *path), text) for place, section in sections for path, text in section.mistakes(placed)]
    if wrong:
        raise ConfigError([document.problem(path, text) for path, text in wrong])
    if refused := zenoh_problems(document, placed) or _mapping_rule_problems(document, placed):
        raise ConfigError(refused)
    for _, section in sections:
        section.set_digest(digest_of(section.named_files()))
    return placed


def _without_empty(data: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """Return the data without empty sections and lists, whose keys may all be commented out."""
    fields = {key_name(name, info): info for name, info in model.model_fields.items()}
    kept: dict[str, Any] = {}
    for name, value in data.items():
        inner = model_of(fields[name].annotation) if name in fields else None
        if value is None and (inner is not None or (name in fields and fields[name].default == ())):
            continue
        kept[name] = _without_empty(value, inner) if isinstance(value, dict) and inner is not None else value
    return kept


def _enabled_sections(section: Section, path: KeyPath) -> Iterator[tuple[KeyPath, Section]]:
    """Yield the sections within a section that are not disabled, with their paths."""
    for name, inner in section:
        if isinstance(inner, Section) and getattr(inner, "enabled", None) is not False:
            yield (*path, name), inner
            yield from _enabled_sections(inner, (*path, name))


def _resolve_paths(value: Any, path: KeyPath, document: Document, missing: list[Problem]) -> Any:
    """Return the value with absolute paths, resolved from the file's folder; add missing files to ``missing``."""
    if isinstance(value, BaseModel):
        if getattr(value, "enabled", None) is False:
            missing = []  # what is off needs no files
        inner = {
            name: _resolve_paths(getattr(value, name), (*path, key_name(name, info)), document, missing)
            for name, info in type(value).model_fields.items()
        }
        changed = {name: new for name, new in inner.items() if new is not getattr(value, name)}
        return value.model_copy(update=changed) if changed else value
    if isinstance(value, tuple):
        items = tuple(_resolve_paths(item, (*path, index), document, missing) for index, item in enumerate(value))
        return items if any(new is not old for new, old in zip(items, value, strict=True)) else value
    if not isinstance(value, Path):
        return value
    try:
        expanded = value.expanduser()
    except RuntimeError:
        missing.append(document.problem(path, f"the home folder in {value} is unknown; write the whole path"))
        return value
    absolute = Path(os.path.abspath(document.file.parent / expanded))  # noqa: PTH100  keeps symbolic links
    names = [part for part in path if isinstance(part, str)]
    if reason := _unusable(absolute, folder=names[-1] in _FOLDERS, needed=path not in CREATED_PATHS):
        missing.append(document.problem(path, reason))
    return absolute


def _unusable(path: Path, *, folder: bool, needed: bool) -> str:
    """Return why this user cannot use a file or folder, "" if it exists, or is missing and not ``needed``."""
    try:
        exists, fits = path.exists(), path.is_dir() == folder
    except OSError as err:  # for example in a folder of another user
        return f"cannot read {path}: {err.strerror}"
    if not exists:
        return f"no such file or folder: {path}" if needed else ""
    mistake = "is a file, not a folder" if folder else "is a folder, not a file"
    return "" if fits else f"{path} {mistake}"


def _mapping_rule_problems(document: Document, config: Config) -> list[Problem]:
    """Return a problem for each invalid file of ``types.mapping_rules``, or else for each rule that cannot apply."""
    files = config.types.mapping_rules
    if not files:
        return []
    from bridge.messages.errors import MessageTypeError
    from bridge.messages.mapping.rules import load_rules
    from bridge.messages.mapping.version_rules import load_version_rules
    from bridge.messages.registry import Registry

    def problem(index: int, err: MessageTypeError) -> Problem:
        return document.problem(("types", "mapping_rules", index), f"{err}; {err.cure}" if err.cure else str(err))

    problems: list[Problem] = []
    versioned = False
    for index, file in enumerate(files):
        try:
            load_rules(file)
            versioned = bool(load_version_rules(file)) or versioned
        except MessageTypeError as err:
            problems.append(problem(index, err))
    if problems or not versioned:
        return problems
    for wrong in Registry.of(config.types).rule_errors():
        index = next((number for number, file in enumerate(files) if str(wrong).startswith(f"{file}, ")), 0)
        problems.append(problem(index, wrong))
    return problems

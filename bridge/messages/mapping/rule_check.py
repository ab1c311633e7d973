"""Checks the configuration's version rules against the known versions of each type."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from itertools import combinations, permutations

from bridge.messages.definitions.schema import Schema
from bridge.messages.definitions.versions import TypeVersions
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.mapping.fields import field_at
from bridge.messages.mapping.releases import fits_by_rule, match_versions, overlap
from bridge.messages.mapping.retyping import obstacle
from bridge.messages.mapping.version_rules import VersionRule, VersionRules
from bridge.messages.values import MessageWriter

_FOLDERS = "add a separate folder for each version of the package to types.folders"


def rule_errors(rules: VersionRules, versions: TypeVersions) -> Iterator[MessageTypeError]:
    """Yield an error, with its cure, for each of the configuration's rules that cannot apply or contradicts another."""
    sound: list[VersionRule] = []
    for rule in rules.given:
        errors = list(_errors(rule, versions))
        yield from errors
        if not errors:
            sound.append(rule)
    for first, second in combinations(sound, 2):
        if (first.older, first.newer) == (second.older, second.newer):
            yield from _contradiction(first, second, versions)
    for rule in sound:
        yield from _wrong_defaults(rule, rules, versions)


def _known(versions: TypeVersions, name: str) -> list[Schema]:
    hashless = versions.hashless(name)
    return [schema for _, schema in versions.of(name).values()] + ([] if hashless is None else [hashless])


def _pairs(rule: VersionRule, versions: TypeVersions) -> list[tuple[Schema, Schema]]:
    """Return all pairs of an older and a newer version, in both orders if the names are the same."""
    olds = _known(versions, rule.older)
    if rule.older == rule.newer:
        return list(permutations(olds, 2))
    return [(old, new) for old in olds for new in _known(versions, rule.newer)]


def _errors(rule: VersionRule, versions: TypeVersions) -> Iterator[MessageTypeError]:
    for name in dict.fromkeys((rule.older, rule.newer)):
        if not _known(versions, name):
            yield MessageTypeError(f"{rule.origin}: no definition of {name} is known", _FOLDERS)
            return
    pairs = _pairs(rule, versions)
    if not pairs:
        yield MessageTypeError(f"{rule.origin}: only one version of {rule.older} is known", _FOLDERS)
        return
    olds, newer = [old for old, _ in pairs], [new for _, new in pairs]
    for path1, path2 in rule.fields.items():
        missing = [_missing(rule, *args) for args in ((rule.older, path1, olds), (rule.newer, path2, newer))]
        yield from (error for error in missing if error is not None)
        if any(missing):
            continue
        kinds = ((field_at(old, _path(path1)), field_at(new, _path(path2))) for old, new in pairs)
        applied = [(kind1, kind2) for kind1, kind2 in kinds if kind1 is not None and kind2 is not None]
        if not applied:
            yield MessageTypeError(
                f"{rule.origin}: only one known version of {rule.older} has {path1} or {path2}, and it has both",
                _FOLDERS,
            )
        for kind1, kind2 in dict.fromkeys(applied):
            if not fits_by_rule(kind1, kind2, VersionRules()) and (reason := obstacle(kind1, kind2)):
                yield MessageTypeError(
                    f"{rule.origin}: {path1} ({kind1}) cannot become {path2} ({kind2}): {reason}",
                    "remove the line: the newer field then gets its default",
                )
    for name in rule.defaults:
        error = _missing(rule, rule.newer, name, newer)
        if error is not None:
            yield error


def _missing(rule: VersionRule, name: str, path: str, schemas: list[Schema]) -> MessageTypeError | None:
    if any(field_at(schema, _path(path)) is not None for schema in schemas):
        return None
    names = list(dict.fromkeys(other.name for schema in schemas for other in schema.root.fields))
    near = difflib.get_close_matches(path, names, 1)
    cure = f"did you mean {near[0]!r}?" if near else f"its fields: {', '.join(names) or 'none'}"
    return MessageTypeError(f"{rule.origin}: no known version of {name} has a field {path!r}", cure)


def _contradiction(first: VersionRule, second: VersionRule, versions: TypeVersions) -> Iterator[MessageTypeError]:
    """Yield an error for each contradiction between two rules for the same pair of types.

    Rules contradict each other if they give a field, or a part of it, different counterparts in a pair of known
    versions, or a field different defaults.
    """
    for old1, new1 in first.fields.items():
        for old2, new2 in second.fields.items():
            if (old1, new1) == (old2, new2):
                continue
            if not (overlap(_path(old1), _path(old2)) or overlap(_path(new1), _path(new2))):
                continue
            for old, new in _pairs(first, versions):
                if all(field_at(old, _path(path)) is not None for path in (old1, old2)) and all(
                    field_at(new, _path(path)) is not None for path in (new1, new2)
                ):
                    yield MessageTypeError(
                        f"{second.origin}: maps {old2} to {new2}, which contradicts {old1} to {new1} in {first.origin}",
                        "keep one of them",
                    )
                    break
    for name in first.defaults.keys() & second.defaults.keys():
        if first.defaults[name] != second.defaults[name]:
            yield MessageTypeError(
                f"{second.origin}: the default of {name} differs from that in {first.origin}", "keep one of them"
            )


def _wrong_defaults(rule: VersionRule, rules: VersionRules, versions: TypeVersions) -> Iterator[MessageTypeError]:
    for old, new in _pairs(rule, versions) if rule.defaults else ():
        target = match_versions(old, new, rules).target
        try:
            MessageWriter(target).message({})
        except ConversionError as err:
            yield MessageTypeError(
                f"{rule.origin}: the default does not fit: {err}", "write a default of the field's type"
            )
            return


def _path(text: str) -> tuple[str, ...]:
    return tuple(text.split("."))

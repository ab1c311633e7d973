"""Generates the example file, the JSON schema and the reference page from the model."""

from __future__ import annotations

import json
import re
import textwrap
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from bridge.config.model import Config
from bridge.config.problems import key_name, model_of

Config.model_rebuild()  # imports the models of all sections


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a section.

    Attributes:
        value: the possible values, in words.
        default: as YAML; None if the key is required, or its default is the machine's name.
        section: the model of the section that the key holds, or of the items of its list; None for a plain value.
    """

    name: str
    value: str
    default: str | None
    description: str
    section: type[BaseModel] | None
    is_list: bool
    required: bool


def keys(model: type[BaseModel]) -> Iterator[Key]:
    """Yield the keys of a section's model, in the model's order."""
    for name, info in model.model_fields.items():
        is_list = typing.get_origin(info.annotation) is tuple
        section = model_of(info.annotation)
        yield Key(
            key_name(name, info),
            _section_text(section, is_list=is_list) if section is not None else _type_text(info),
            _default(info),
            info.description or "",
            section,
            is_list,
            info.is_required(),
        )


def _section_text(section: type[BaseModel], *, is_list: bool) -> str:
    title = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", section.__name__).lower()
    return f"list of {title}s" if is_list else "section"


def _default(info: FieldInfo) -> str | None:
    if info.default_factory is dict:
        return "{}"
    if info.default is PydanticUndefined:
        return None
    return "[]" if info.default == () else json.dumps(info.default)


def _type_text(info: FieldInfo) -> str:
    text = _annotation_text(info.annotation)
    low = high = pattern = ""
    for constraint in info.metadata:
        match constraint:
            case annotated_types.Ge(ge):
                low = f"from {ge}"
            case annotated_types.Gt(gt):
                low = f"above {gt}"
            case annotated_types.Le(le):
                high = f"up to {le}"
            case _ if getattr(constraint, "pattern", None):
                pattern = f"matching {constraint.pattern}"
    return " ".join(part for part in (text, low, high, pattern) if part)


def _annotation_text(annotation: Any) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Literal:
        return ", ".join(json.dumps(a) if isinstance(a, bool) else str(a) for a in arguments)
    if origin in {typing.Union, types.UnionType}:
        return " or ".join(_annotation_text(a) for a in arguments if a is not type(None))
    if origin is tuple:
        text = _annotation_text(arguments[0])
        return f"list of {text}s" if not text.startswith("list of ") else f"list of lists{text.removeprefix('list')}"
    if origin is dict:
        return "map"
    if origin is typing.Annotated:
        return _annotation_text(arguments[0])
    names = {bool: "true, false", int: "integer", float: "number", str: "text", Path: "path"}
    return names.get(annotation, str(annotation))


WIDTH = 100
SCHEMA_FILE = "midspan.schema.json"  # the schema's name among the files in ``configs/``


def schema() -> str:
    """Return the JSON schema of the configuration file."""
    document = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **_either_form(Config.model_json_schema(by_alias=True)),
        "title": "Midspan's configuration",
    }
    return json.dumps(document, indent=2) + "\n"


def _either_form(node: Any, name: str = "") -> Any:
    """Also allow a single text for a list of texts, and a list with one address for ``listen``, as `Section` does."""
    if isinstance(node, list):
        return [_either_form(item) for item in node]
    if not isinstance(node, dict):
        return node
    node = {key: _either_form(value, key) for key, value in node.items()}
    items = node.get("items", {})
    texts = node.get("type") == "array" and items.get("type") == "string" and "prefixItems" not in node
    if not texts and not (name == "listen" and node.get("type") == "string"):
        return node
    outer = {key: node.pop(key) for key in ("default", "description", "title") if key in node}
    if texts:
        return {"anyOf": [node, items], **outer}
    return {"anyOf": [node, {"type": "array", "items": node, "minItems": 1, "maxItems": 1}], **outer}


def example() -> str:
    """Return a file with all keys at their defaults, each with its description; it loads to the defaults."""
    head = [
        "# Midspan's configuration: every key with its default. All keys are optional.",
        "# 'midspan config check FILE' checks a file; 'midspan config schema' is for editors.",
    ]
    return "\n".join([*head, *_example_section(Config, "")]) + "\n"


def _example_section(model: type[BaseModel], indent: str) -> Iterator[str]:
    for key in keys(model):
        yield ""
        yield from _comment(_words(key), indent)
        if key.section is not None and not key.is_list:
            yield f"{indent}{key.name}:"
            yield from _example_section(key.section, indent + "  ")
        elif key.default is None:
            yield f"{indent}# {key.name}:"
        else:
            yield f"{indent}{key.name}: {key.default}"
            if key.section is not None:
                yield from _list_item(key.section, indent)


def _list_item(model: type[BaseModel], indent: str) -> Iterator[str]:
    """Yield the keys of a list's items, as comments."""
    yield f"{indent}# Keys of each item:"
    for key in keys(model):
        yield from _comment(f"{key.name} ({_type(key)}): {key.description}", indent, "  - ", "    ")
        nested = list(keys(key.section)) if key.section is not None else []
        for inner in nested:
            yield from _comment(f"{inner.name} ({inner.value}): {inner.description}", indent, "      - ", "        ")


def _type(key: Key) -> str:
    return key.value if key.default in {None, "null"} else f"{key.value}; default {key.default}"


def _words(key: Key) -> str:
    plain = key.section is not None and not key.is_list
    return key.description if plain else f"{key.description} ({key.value})"


def _comment(text: str, indent: str, first: str = " ", rest: str = " ") -> list[str]:
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=f"{indent}#{first}",
        subsequent_indent=f"{indent}#{rest}",
        break_long_words=False,
        break_on_hyphens=False,
    )


_REFERENCE_HEAD = """# Configuration reference

<!-- Generated by `midspan config reference`; do not edit. -->

Midspan reads one YAML file. Every key is optional, and on a single machine Midspan runs with the defaults, which
`midspan config example` prints. Without `--config`, Midspan uses the first of these files: `$MIDSPAN_CONFIG`,
`./midspan.yaml`, `~/.config/midspan/midspan.yaml` (or under `$XDG_CONFIG_HOME`), `/etc/midspan/midspan.yaml`. Without
any file, it uses the defaults. Relative paths are relative to the file's folder.

`version` is the format of the file. `midspan config migrate FILE` converts an older file to the current keys. It
preserves comments, turns obsolete keys into comments and saves the former file as `FILE.old`. If some changes have to
be made by hand, it lists them and exits with code 3. Midspan rejects files in a newer format, so give the `version`
in files that an older Midspan may read.

`midspan config check FILE` reports every problem with its line and column, including unknown and duplicate keys,
and two listeners on the same port. It also reads the files that the configuration names, except the maps and places of
`store`, the folders of message definitions, and the certificates of `hub.open`, which `midspan doctor` checks.
A list of texts can also be written as one text (`trusted: operator1`), and the address of a `listen` as a list of one.
`midspan config schema` prints a JSON schema; with

```yaml
# yaml-language-server: $schema=midspan.schema.json
```

as the first line of a file, editors check and complete it while you type.

`midspan reload` (or SIGHUP, or `systemctl reload midspan`) checks the file and loads it again. A file with a problem
changes nothing: the daemon keeps its earlier configuration, and the log, `midspan status` and `midspan doctor`
report the reason until a reload succeeds. Only the workers that use changed keys reload or restart; modules
stop before the sides, so that their last messages arrive. `name` and `state` need a restart of the daemon. If the
contents of a file that a key names have changed, a reload acts as if the key had changed, and refuses contents that
cannot be used:

| Changed contents of | A reload |
|---|---|
| `ini` of a module, and the files that it includes or imports | restarts the module |
| `hub.zenoh`, `hub.router_zenoh`, and the certificates, keys and password files that they name | restarts all workers |
| `hub.open.zenoh`, and the files that it names | opens the router for other machines again |
| `zenoh.zenoh`, and the files that it names; `ros1.packages`; `ros2.profile` | restarts that side |
| `types.folders`, `types.mapping_rules` | restarts all workers except the router and the ROS 1 master |
| `sim.plan`, with the images of a map; `sim.robot` | restarts the simulation |
| `store.maps`, `store.locations` | imports new maps and places, and replaces nothing, as at the start |
| certificates and keys of `hub.open` | is not needed: the router and the servers load new ones within seconds |
| Python packages, and files in the `options` of your own modules | has no effect: restart the daemon |
"""


def reference() -> str:
    """Return the reference page, in Markdown."""
    return _REFERENCE_HEAD + "\n".join(_reference_section("Top level", Config, "", ""))


def _reference_section(title: str, model: type[BaseModel], description: str, path: str) -> Iterator[str]:
    yield f"\n## {title}\n"
    if description:
        yield f"{description}\n"
    yield "| Key | Value | Default | What it does |"
    yield "|---|---|---|---|"
    for key in keys(model):
        default = "see there" if key.section is not None and not key.is_list else _default_text(key)
        yield f"| `{key.name}` | {_cell(key.value)} | {default} | {_cell(key.description)} |"
    for key in keys(model):
        if key.section is None:
            continue
        inner = f"{path}{key.name}"
        words = (key.section.__doc__ or "").replace("``", "`")
        text = "\n\n".join(" ".join(part.split()) for part in words.split("\n\n"))
        yield from _reference_section(f"`{inner}`", key.section, text, f"{inner}{'[]' if key.is_list else ''}.")


def _default_text(key: Key) -> str:
    if key.default is None:
        return "needed" if key.required else "the machine's name"
    return "none" if key.default == "null" else f"`{key.default}`"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")

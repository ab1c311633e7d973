"""Bills of materials in CycloneDX's JSON: what a wheel or a Debian package contains in addition to Midspan's own code.

A wheel contains its bill in ``.dist-info/sboms`` (https://peps.python.org/pep-0770/); that of a Debian package is a
file next to the package.
Requirements that pip installs separately are in the wheel's metadata instead.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
import zipfile
from collections.abc import Sequence
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from typing import Any

from packaging.utils import canonicalize_name

from scripts.reproducible import ROOT, epoch

DEFINITIONS = ("bridge/interfaces/definitions/README.md", "bridge/messages/definitions/README.md")
"""Tables of the message definitions in the wheel: packages, versions and sources."""

_ROW = re.compile(r"^\|(?P<packages>[^|]*\|[^|]*\|).*?github\.com/(?P<source>[\w./-]+)", re.MULTILINE)
_PACKAGE = re.compile(r"\b[a-z0-9_]+_(?:msgs|srvs|interfaces|toolbox)\b")
_VERSION = re.compile(r"\b\d+(?:\.\d+)+")
Component = dict[str, Any]


def document(described: Component, contained: Sequence[Component]) -> str:
    """Return the document of a package and the components in it."""
    parts = sorted(contained, key=lambda part: str(part["bom-ref"]))
    return json.dumps(
        {
            "bomFormat": "CycloneDX",
            "specVersion": "1.6",
            "version": 1,
            "metadata": {
                "timestamp": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(epoch())),
                "component": described,
            },
            "components": parts,
            "dependencies": [
                {"ref": described["bom-ref"], "dependsOn": [part["bom-ref"] for part in parts]},
                *({"ref": part["bom-ref"]} for part in parts),
            ],
        },
        indent=1,
    )


def of_wheel(wheel: Path, *, kind: str = "library") -> Component:
    """Return a wheel as a component, from its metadata."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA") and name.count("/") == 1)
        metadata = message_from_bytes(archive.read(name))
    return {
        **_distribution(str(canonicalize_name(str(metadata["Name"]))), str(metadata["Version"]), kind),
        **_licenses(metadata),
    }


def with_digest(component: Component, file: Path) -> Component:
    """Add the digest of a component's file."""
    return {**component, "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(file.read_bytes()).hexdigest()}]}


def _distribution(name: str, version: str, kind: str = "library") -> Component:
    purl = f"pkg:pypi/{name}@{version}"
    return {"type": kind, "bom-ref": purl, "name": name, "version": version, "purl": purl}


def _licenses(metadata: Message) -> Component:
    if expression := metadata["License-Expression"]:
        return {"licenses": [{"expression": str(expression)}]}
    classifiers = [str(text) for text in metadata.get_all("Classifier", []) if str(text).startswith("License ::")]
    names = [text.rpartition(" :: ")[2] for text in classifiers] or str(metadata["License"] or "").splitlines()[:1]
    return {"licenses": [{"license": {"name": name}} for name in names]} if names else {}


def compiled_in(cython: str) -> Component:
    """Return Cython's runtime code, which is in every compiled kernel."""
    return {**_distribution("cython", cython), "licenses": [{"license": {"id": "Apache-2.0"}}]}


def definitions() -> list[Component]:
    """Return the message packages whose definitions are in the wheel."""
    components: dict[str, Component] = {}
    for file in DEFINITIONS:
        for row in _ROW.finditer((ROOT / file).read_text(encoding="utf-8")):
            line = row.string[row.start() : row.string.find("\n", row.start())]
            number = _VERSION.search(line)
            for name in _PACKAGE.findall(row["packages"]):
                version = {"version": number[0]} if number else {}
                ref = "-".join(("definitions", name, *version.values()))
                components[ref] = {
                    "type": "data",
                    "bom-ref": ref,
                    "name": name,
                    **version,
                    "description": "message definitions (types, names, defaults, constants)",
                    "externalReferences": [{"type": "vcs", "url": f"https://github.com/{row['source']}"}],
                }
    return list(components.values())

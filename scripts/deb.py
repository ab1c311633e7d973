"""Builds the Debian package of a release, from the wheels of `make dist` and the locked libraries (`make deb`).

The package has a private environment below /opt/midspan, laid out as a virtual environment of the release's Python.
Compiled files work only with that Python, so each release has its own package; pip can download wheels for a Python or
a processor that this machine does not have. The units, the configuration and the user are as with `midspan install`.
Each package has a bill of materials next to it (`scripts.sbom`).
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import importlib.metadata
import re
import shutil
import sys
import tomllib
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from email.utils import formatdate
from pathlib import Path
from typing import Any

import shtab
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from bridge.cli.main import VERBS, build_parser  # noqa: E402
from bridge.daemon.install import UNITS  # noqa: E402
from scripts import dist, lock, manual, processor, sbom  # noqa: E402
from scripts.reproducible import epoch, rewrite_wheel  # noqa: E402

EXTRAS = ("ros2", "web", "foxglove")
"""The package lacks the simulator, because DART adds a quarter of the size, and requires OpenGL on the robot."""

PRIVATE = Path("opt/midspan")
CONFFILES = ("etc/midspan/midspan.yaml", "etc/midspan/environment")
_SOURCE = ROOT / "packaging" / "debian"


@dataclass(frozen=True)
class Release:
    """A release of Debian or Ubuntu.

    Attributes:
        suffix: suffix of the package's version.
        python: minor version of the release's Python 3.
        glibc: minor version of its glibc 2, which limits the usable wheels.
    """

    suffix: str
    python: int
    glibc: int


RELEASES = {
    "bookworm": Release("~deb12", 11, 36),
    "noble": Release("~ubuntu24.04", 12, 39),
    "resolute": Release("~ubuntu26.04", 14, 43),
    "trixie": Release("~deb13", 13, 41),
}


def libraries(release: Release, arch: str, extras: Sequence[str] = EXTRAS, more: Sequence[str] = ()) -> list[str]:
    """Return the libraries of Midspan and its extras with their versions.

    The versions are the installed ones, which match the lock files (tests/setup/test_lock.py).

    Args:
        release: the target release, whose Python may not need all of them.
        arch: Debian's name of the processor.
        extras: Midspan's extras.
        more: names of other packages.
    """
    linux = lock.SYSTEMS[0].on(f"3.{release.python}")
    system = replace(linux, environment={**linux.environment, "platform_machine": processor.MACHINES[arch]})
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(text for extra in extras for text in project["optional-dependencies"][extra])]
    wanted += more
    installed: dict[str, dict[str, Any]] = {
        canonicalize_name(distribution.name): {
            "name": distribution.name,
            "version": distribution.version,
            "requires_dist": distribution.requires or (),
        }
        for distribution in importlib.metadata.distributions()
    }
    versions, missing = lock.reached(wanted, installed, system)
    if missing:
        raise RuntimeError(f"not installed here: {', '.join(missing)}; 'make setup' installs the locked versions")
    return [f"{name}=={version}" for name, version in sorted(versions.items())]


def stage(release: Release, wheels: Sequence[Path], root: Path, arch: str = "amd64") -> list[sbom.Component]:
    """Write all files of the package into a folder, and return its components.

    Args:
        release: the target release.
        wheels: the wheels of Midspan and yarp-compat.
        root: the folder.
        arch: Debian's name of the processor.
    """
    got = root.with_name(f"{root.name}-wheels")
    site = root / PRIVATE / "lib" / f"python3.{release.python}" / "site-packages"
    components = []
    for wheel in (*_download(release, got, arch), *wheels):
        unpack(wheel, site, root / PRIVATE)
        components.append(sbom.with_digest(sbom.of_wheel(wheel), wheel))
    shutil.rmtree(got)
    foreign = [file.name for file in site.rglob("*.cpython-*.so") if f".cpython-3{release.python}-" not in file.name]
    if foreign:
        raise RuntimeError(f"built for another Python than 3.{release.python}: {', '.join(sorted(foreign))}")
    foreign = [file.name for file in (root / PRIVATE).rglob("*.so*") if not _runs_on(file, arch)]
    if foreign:
        raise RuntimeError(f"built for another processor than {arch}: {', '.join(sorted(foreign))}")
    _environment(release, root)
    _system_files(root)
    return components


def _runs_on(library: Path, arch: str) -> bool:
    """Return whether a compiled file is for a processor; True for other files, such as a linker script."""
    with library.open("rb") as file:
        header = file.read(20)
    return header[:4] != b"\x7fELF" or int.from_bytes(header[18:20], "little") == processor.ELF[arch]


def _download(release: Release, to: Path, arch: str) -> list[Path]:
    return download(release, to, arch, libraries(release, arch))


def download(release: Release, to: Path, arch: str, wanted: Sequence[str]) -> list[Path]:
    """Download wheels for the release's Python with pip; pure libraries with only a source release are built here."""
    pip = [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check"]
    command = [*pip, "download", "--no-deps", "-d", str(to), "--implementation", "cp"]
    command += ["--python-version", f"3.{release.python}"]
    tags = ["manylinux2014", *(f"manylinux_2_{minor}" for minor in range(5, release.glibc + 1))]
    for tag in tags:
        command += ["--platform", f"{tag}_{processor.MACHINES[arch]}"]
    dist.run([*command, *wanted], ROOT)
    downloaded = set(to.glob("*.whl"))
    for source in to.glob("*.tar.gz"):
        dist.run([*pip, "wheel", "--no-deps", "-w", str(to), str(source)], ROOT)
    wheels = sorted(to.glob("*.whl"))
    for built in set(wheels) - downloaded:
        rewrite_wheel(built, {})  # the bill of materials has its digest, but setuptools' modes depend on the umask
    return wheels


def unpack(wheel: Path, site: Path, prefix: Path) -> None:
    """Install a wheel like pip into an environment of another machine, without its programs.

    https://packaging.python.org/en/latest/specifications/binary-distribution-format/. Pip's own ``--target`` drops the
    wheels' files in ``data/lib``: all of ROS 2's libraries.
    """
    with zipfile.ZipFile(wheel) as archive:
        for info in archive.infolist():
            data, _, inner = info.filename.partition(".data/")
            scheme, _, name = inner.partition("/")
            if info.is_dir() or scheme in ("scripts", "headers") or "__pycache__" in info.filename:
                continue
            path = _parent((prefix if scheme == "data" else site) / (name if inner else data))
            path.write_bytes(archive.read(info))
            path.chmod(0o755 if info.external_attr >> 16 & 0o100 else 0o644)
    for record in site.glob(f"{wheel.name.split('-')[0]}-*.dist-info/RECORD"):
        text = re.sub(r"^[^/,]+\.data/(scripts|headers)/.*\n", "", record.read_text("utf-8"), flags=re.MULTILINE)
        text = re.sub(r"^[^/,]+\.data/data/", "../../../", text, flags=re.MULTILINE)
        record.write_text(re.sub(r"^[^/,]+\.data/\w+/", "", text, flags=re.MULTILINE), encoding="utf-8")


def _parent(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _write(path: Path, text: str, mode: int = 0o644) -> None:
    _parent(path).write_text(text, encoding="utf-8")
    path.chmod(mode)


def _environment(release: Release, root: Path) -> None:
    """Write the files that make the folder an environment of the system's Python, and the command."""
    python = f"/usr/bin/python3.{release.python}"
    _write(
        root / PRIVATE / "pyvenv.cfg", f"home = /usr/bin\ninclude-system-site-packages = false\nexecutable = {python}\n"
    )
    command = "import sys\n\nfrom bridge.cli.main import main\n\nsys.exit(main())\n"
    _write(root / PRIVATE / "bin/midspan", f"#!/{PRIVATE}/bin/python3\n{command}", 0o755)
    (root / PRIVATE / "bin/python3").symlink_to(python)
    (_parent(root / "usr/bin/midspan")).symlink_to(f"/{PRIVATE}/bin/midspan")


def _system_files(root: Path) -> None:
    """Write units, user, configuration, manual and completions."""
    for unit in UNITS:
        text = (ROOT / "packaging" / unit).read_text(encoding="utf-8")
        _write(root / "lib/systemd/system" / unit, text.replace("@MIDSPAN@", f"/{PRIVATE}/bin/midspan"))
    shipped = root / PRIVATE / "share/midspan"
    _write(root / "usr/lib/sysusers.d/midspan.conf", (shipped / "packaging/midspan.sysusers").read_text("utf-8"))
    _write(root / CONFFILES[0], (shipped / "configs/default.yaml").read_text("utf-8"))
    _write(root / CONFFILES[1], (shipped / "packaging/environment").read_text("utf-8"))
    (root / "etc/midspan/midspan.schema.json").symlink_to(f"/{PRIVATE}/share/midspan/configs/midspan.schema.json")
    parser = build_parser(VERBS)
    for shell, place in (
        ("bash", "bash-completion/completions/midspan"),
        ("zsh", "zsh/vendor-completions/_midspan"),
        ("fish", "fish/vendor_completions.d/midspan.fish"),
    ):
        _write(root / "usr/share" / place, shtab.complete(parser, shell=shell) + "\n")
    _write_packed(root / "usr/share/man/man1/midspan.1.gz", manual.page(dist.version()))
    _write(root / "usr/share/doc/midspan/copyright", (_SOURCE / "copyright").read_text("utf-8"))
    _write(root / "usr/share/lintian/overrides/midspan", (_SOURCE / "lintian-overrides").read_text("utf-8"))


def _write_packed(path: Path, text: str) -> None:
    _parent(path).write_bytes(gzip.compress(text.encode(), mtime=0))


def pack(
    release: Release, root: Path, to: Path, version: str | None = None, *, arch: str = "amd64", compression: str = "xz"
) -> Path:
    """Build the package from the files; return its path.

    Args:
        release: the target release.
        root: folder of the files; their modes are set, and dpkg's control files are added.
        to: folder for the package.
        version: the version without the release's suffix; default: this checkout's version.
        arch: Debian's name of the processor.
        compression: dpkg-deb's name of the compression; "none" and "gzip" are quick.
    """
    full = f"{version or dist.version()}{release.suffix}"
    _write_packed(root / "usr/share/doc/midspan/changelog.gz", _changelog(full))
    files = sorted(path for path in root.rglob("*") if "DEBIAN" not in path.parts and not path.is_symlink())
    for path in (root, *files):
        path.chmod(0o755 if path.is_dir() or _runs(path) else 0o644)
    files = [path for path in files if path.is_file()]
    sums = "".join(f"{hashlib.md5(f.read_bytes()).hexdigest()}  {f.relative_to(root)}\n" for f in files)  # noqa: S324
    control = root / "DEBIAN"
    _write(control / "md5sums", sums)
    control.chmod(0o755)
    _write(control / "conffiles", "".join(f"/{name}\n" for name in CONFFILES))
    for name in ("postinst", "prerm", "postrm"):
        _write(control / name, (_SOURCE / name).read_text("utf-8"), 0o755)
    size = sum(path.stat().st_size for path in files) // 1024
    python = f"python3 (>= 3.{release.python}), python3 (<< 3.{release.python + 1})"
    text = (_SOURCE / "control").read_text("utf-8")
    values = {"VERSION": full, "ARCH": arch, "SIZE": str(size), "PYTHON": python}
    for mark, value in values.items():
        text = text.replace(f"@{mark}@", value)
    _write(control / "control", text)
    to.mkdir(parents=True, exist_ok=True)
    package = to / f"midspan_{full}_{arch}.deb"
    dist.run(["dpkg-deb", "--root-owner-group", f"-Z{compression}", "--build", str(root), str(package)], to)
    return package


def _runs(file: Path) -> bool:
    """Return whether a file is a program; a mode is not enough, because wheels mark libraries as executable too."""
    return bool(file.stat().st_mode & 0o100) and ".so" not in file.suffixes and file.suffix != ".py"


def _changelog(version: str) -> str:
    maintainer = re.search(r"^Maintainer: (.+)$", (_SOURCE / "control").read_text("utf-8"), re.MULTILINE)
    assert maintainer is not None
    dated = formatdate(epoch())
    return f"midspan ({version}) stable; urgency=medium\n\n  * See CHANGELOG.md.\n\n -- {maintainer[1]}  {dated}\n"


def own_wheels(folder: Path, arch: str) -> list[Path]:
    """Return Midspan's compiled wheel and that of yarp-compat in a folder, of this checkout's version."""
    version = dist.version()
    compiled = f"midspan-{version}-cp311-abi3-*_{processor.MACHINES[arch]}.whl"
    wheels = [*folder.glob(compiled), *folder.glob(f"yarp_compat-{version}-*.whl")]
    if len(wheels) != 2:
        raise RuntimeError(f"no wheels of {version} for {arch} in {folder}: run 'make dist ARCH={arch}'")
    return wheels


def write_sbom(package: Path, components: Sequence[sbom.Component]) -> Path:
    """Write a package's bill of materials next to it."""
    name, version, arch = package.stem.split("_")
    purl = f"pkg:deb/{name}@{version}?arch={arch}"
    described = {"type": "application", "bom-ref": purl, "name": name, "version": version, "purl": purl}
    file = package.with_suffix(".cdx.json")
    file.write_text(sbom.document(sbom.with_digest(described, package), components), encoding="utf-8")
    return file


def main() -> int:
    """Build the packages of the given releases."""
    parser = argparse.ArgumentParser(description="Build the Debian packages.")
    parser.add_argument("release", nargs="*", default=sorted(RELEASES), help="default: all")
    parser.add_argument("--folder", type=Path, default=ROOT / "dist", help="folder of the wheels and the packages")
    processor.add_option(parser)
    args = parser.parse_args()
    work = ROOT / "build" / "deb"
    try:
        for name in args.release:
            shutil.rmtree(work, ignore_errors=True)
            dist.report(f"the package for {name} on {args.arch} (two minutes)")
            components = stage(RELEASES[name], own_wheels(args.folder, args.arch), work, args.arch)
            package = pack(RELEASES[name], work, args.folder.absolute(), arch=args.arch)
            for file in (package, write_sbom(package, components)):
                sys.stdout.write(f"{file.stat().st_size / 1e6:6.2f} MB  {file}\n")
    except (RuntimeError, KeyError) as err:
        sys.exit(f"deb: {err}")
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

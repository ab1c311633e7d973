"""What `make dist` builds: whole, without anything else of the repository, and each module in one distribution."""

from __future__ import annotations

import re
import subprocess
import tarfile
import tomllib
import zipfile
from collections.abc import Sequence
from email import message_from_string
from pathlib import Path

import pytest

from scripts import dist
from tests.setup.machine import ROOT


def tracked(*names: str) -> set[str]:
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", *names]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    return {name for name in listed.split("\0") if name and (ROOT / name).is_file()}


def test_each_module_is_in_one_distribution(tmp_path: Path) -> None:
    midspan, compat = tmp_path / "midspan", tmp_path / "compat"
    for folder, lay_out in ((midspan, dist.lay_out_midspan), (compat, dist.lay_out_yarp_compat)):
        folder.mkdir()
        lay_out(folder)
    assert not (midspan / "yarp_compat").exists()
    assert (compat / "yarp_compat" / "__init__.py").is_file()
    assert sorted(entry.name for entry in compat.iterdir()) == [
        "LICENSE", "README.md", "VERSION", "pyproject.toml", "yarp_compat",
    ]  # fmt: skip
    told = tomllib.loads((midspan / "pyproject.toml").read_text(encoding="utf-8"))
    assert f"yarp-compat=={dist.version()}" in told["project"]["dependencies"]
    assert told["tool"]["setuptools"]["packages"]["find"]["include"] == ["bridge*", "navigation*", "sim*"]
    assert not list(midspan.rglob("*.so")), "nothing that was built"


def test_a_change_that_fits_no_one_place_is_refused() -> None:
    with pytest.raises(ValueError, match="2 times"):
        dist.replaced("a = 1\na = 1\n", "a = 1", "a = 2")


def test_links_of_the_repository_are_words_on_an_index() -> None:
    text = "See [rules](docs/rules.md#x), [zenoh](https://zenoh.io).\n![a picture](docs/a.png)\nEnd"
    assert dist.without_local_links(text) == "See rules, [zenoh](https://zenoh.io).\nEnd"
    readme = dist.without_local_links((ROOT / "README.md").read_text(encoding="utf-8"))
    assert not re.search(r"\]\((?!https://)", readme)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Sequence[Path]:
    """All that is built."""
    folder = tmp_path_factory.mktemp("dist")
    return dist.build(folder / "dist", folder / "work")


def only(files: Sequence[Path], pattern: str) -> Path:
    (found,) = (file for file in files if file.match(pattern))
    return found


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if not name.endswith("/")}


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_wheel_has_each_file_of_its_packages_and_no_other(files: Sequence[Path]) -> None:
    share = f"midspan-{dist.version()}.data/data/share/midspan/"
    outside = {f"{share}{name}" for name in tracked("configs", "packaging") if "packaging/yarp_compat" not in name}
    outside |= {f"{share}{n}" for n in tracked("examples") if n.count("/") == 1 and not n.endswith(".md")}
    packages = tracked("bridge", "navigation", "sim")
    pure = {name for name in names(only(files, "midspan-*-none-any.whl")) if ".dist-info/" not in name}
    assert pure == packages | outside
    compiled = {n for n in names(only(files, "midspan-*-cp311-abi3-manylinux*.whl")) if ".dist-info/" not in n}
    built = {f"{module.replace('.', '/')}.abi3.so" for module in kernel_modules()} | {"bridge/kernels.json"}
    assert compiled == pure | built
    compat = {n for n in names(only(files, "yarp_compat-*-none-any.whl")) if ".dist-info/" not in n}
    assert compat == tracked("yarp_compat")


def kernel_modules() -> tuple[str, ...]:
    from bridge import kernels

    return (kernels.SHARED, *kernels.C_MODULES, *kernels.KERNELS)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_what_the_distributions_say_of_themselves(files: Sequence[Path]) -> None:
    for file in files:
        if file.suffix == ".whl":
            with zipfile.ZipFile(file) as archive:
                (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
                said = message_from_string(archive.read(name).decode())
        else:
            with tarfile.open(file) as archive:
                (member,) = (m for m in archive.getmembers() if m.name.count("/") == 1 and m.name.endswith("/PKG-INFO"))
                stored = archive.extractfile(member)
                assert stored is not None
                said = message_from_string(stored.read().decode())
        assert said["Version"] == dist.version()
        assert said["Description-Content-Type"] == "text/markdown"
        assert said["License-Expression"] == "Apache-2.0"
        assert not re.search(r"\]\((?!https://)", str(said.get_payload()))
        needed = [text for text in said.get_all("Requires-Dist", []) if "extra ==" not in text]
        if file.name.startswith("yarp_compat"):
            assert needed == ["numpy"]
        else:
            assert f"yarp-compat=={dist.version()}" in needed
            assert {"ros2", "sim", "web", "foxglove"} <= set(said.get_all("Provides-Extra"))

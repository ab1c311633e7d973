"""What `make test-arm64` runs under qemu, run on this machine: results, their comparison, and the wheel check."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from bridge import kernels
from scripts import arm64
from tests.arm64.results import differences, results
from tests.support import foreign
from tests.support.missing import COMPILER, needs


@needs(COMPILER)
def test_each_kernel_has_results_which_are_equal_in_every_run() -> None:
    first = results()
    assert differences(first, json.loads(json.dumps(results()))) == []
    names = {part for name in first for part in re.split(r"[. ]", name)[0].split("+")}
    assert names == {module.rpartition(".")[2] for module in kernels.KERNELS}


def test_a_different_result_is_named_with_its_first_different_value() -> None:
    here = {"equal": ["1", [1.0]], "bits": ["2", [1.0, 0.5, -0.0]], "size": ["3", [1]], "nan": ["4", [np.nan]], "a": []}
    there = {"equal": ["1", [1.0]], "bits": ["5", [1.0, 0.25, 0.0]], "size": ["6", []], "nan": ["7", [np.nan]]}
    assert differences(here, there) == [
        "a: missing",
        "bits: 2 of 3 values differ; value 1 is 0.5 here, 0.25 there",
        "size: 1 values here, 0 there",
        "nan: values are equal, but not their bytes (NaN)",
    ]


def test_the_tests_of_every_kernel_run_there() -> None:
    files = [arm64.ROOT / name for name in arm64.KERNEL_TESTS]
    texts = [f.read_text("utf-8") for path in files for f in ([path] if path.suffix else path.glob("test_*.py"))]
    for module in kernels.KERNELS:
        package, _, name = module.rpartition(".")
        pattern = rf"\b{re.escape(module)}\b|from {re.escape(package)} import [^\n]*\b{name}\b"
        assert [text for text in texts if re.search(pattern, text)], module


def wheel(folder: Path, digests: dict[str, str]) -> Path:
    """Write a wheel that contains only the record of its kernels."""
    file = folder / "midspan-1.0-cp311-abi3-manylinux2014_aarch64.whl"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("bridge/kernels.json", json.dumps({"cython": "3.3", **digests}))
    return file


def test_a_wheel_of_other_sources_is_detected(tmp_path: Path) -> None:
    digests = {module: kernels.digest(module, "3.3") for module in kernels.KERNELS}
    assert arm64.stale(wheel(tmp_path, digests)) == []
    digests["sim.laser_kernel"] = "another"
    del digests["bridge.tf.history"]
    assert arm64.stale(wheel(tmp_path, digests)) == ["bridge.tf.history", "sim.laser_kernel"]


def test_what_the_machine_lacks_is_named_with_its_cure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(foreign, "REGISTERED", tmp_path / "qemu-aarch64")
    monkeypatch.setattr(foreign.shutil, "which", lambda name, **_: f"/usr/bin/{name}")
    monkeypatch.setattr(foreign.os, "geteuid", lambda: 0)
    monkeypatch.setattr(foreign.platform, "release", lambda: "6.7.1-test")
    assert foreign.missing() == []
    monkeypatch.setattr(foreign.platform, "release", lambda: "6.1.0-32-amd64")
    (old,) = foreign.missing()
    assert "Linux 6.7" in old
    monkeypatch.setattr(foreign.shutil, "which", lambda *_, **__: None)
    monkeypatch.setattr(foreign.os, "geteuid", lambda: 1000)
    lacks = " ".join(foreign.missing())
    for word in ("apt install debootstrap", "apt install qemu-user-static", "sudo"):
        assert word in lacks
    (tmp_path / "qemu-aarch64").touch()
    assert "qemu" not in " ".join(foreign.missing())


def test_an_unknown_release_is_rejected(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["arm64.py", "sid"])
    with pytest.raises(SystemExit):
        arm64.main()
    assert "unknown release sid; known: bookworm, trixie" in capsys.readouterr().err

"""The check of the console's certificate."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.doctor.check import Result
from bridge.hub.security import certificates
from bridge.hub.security.certificates import Authority
from bridge.web.checks import check_certificate
from tests.doctor.parts import around, only

TOKENS = {"anna": {"sha256": "0" * 64}}


def place(folder: Path, **web: Any) -> Any:
    section = {"enabled": True, "tokens": TOKENS, **web}
    return around({"name": "robot1", "hub": {"open": {"keys": str(folder)}}, "web": section})


def test_console_on_loopback_needs_no_certificate() -> None:
    assert only(check_certificate(around({"web": {"enabled": True}}))).result is Result.SKIP


def test_public_metrics_need_a_certificate_without_a_console(tmp_path: Path) -> None:
    open_to_all = {"enabled": True, "listen": "0.0.0.0:9480"}
    config = {"hub": {"open": {"keys": str(tmp_path)}}, "web": {"tokens": TOKENS}, "metrics": open_to_all}
    finding = only(check_certificate(around(config)))
    assert finding.result is Result.FAIL
    assert "the worker metrics cannot start" in finding.seen


def test_missing_certificate_files_are_reported(tmp_path: Path) -> None:
    finding = only(check_certificate(place(tmp_path)))
    assert finding.result is Result.FAIL
    assert "there is no" in finding.seen


@pytest.mark.parametrize(
    ("days", "mode", "names", "seen"),
    [(400, 0o600, [], "browsers accept the console as robot1"), (10, 0o600, [], "expires in"),
     (0, 0o600, [], "expired on"), (400, 0o644, [], "other users can read"),
     (400, 0o600, ["tablet"], "browsers warn about tablet")],
)  # fmt: skip
def test_certificate_and_key_are_examined(tmp_path: Path, days: int, mode: int, names: list[str], seen: str) -> None:
    authority = Authority(tmp_path)
    authority.make()
    authority.issue("robot1", days=days)
    (tmp_path / "robot1.key").chmod(mode)
    finding = only(check_certificate(place(tmp_path, names=names)))
    assert seen in finding.seen
    assert ("set this machine's clock if it is not" in finding.cure) is (days == 0)


def test_the_key_of_another_certificate_is_reported(tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    authority.make()
    for name in ("robot1", "robot2"):
        authority.issue(name)
    (tmp_path / "robot1.key").write_bytes((tmp_path / "robot2.key").read_bytes())
    finding = only(check_certificate(place(tmp_path)))
    assert finding.result is Result.FAIL
    assert f"cannot start: {tmp_path / 'robot1.key'} is not the key of {tmp_path / 'robot1.pem'}" in finding.seen


def test_the_mode_of_a_key_is_ignored_on_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Authority(tmp_path).make()
    Authority(tmp_path).issue("robot1")
    (tmp_path / "robot1.key").chmod(0o666)
    monkeypatch.setattr("bridge.hub.security.key_files.sys", SimpleNamespace(platform="win32"))
    assert only(check_certificate(place(tmp_path))).result is Result.OK


def test_a_certificate_that_is_not_valid_yet_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Authority(tmp_path).make()
    monkeypatch.setattr(certificates, "_EARLIER", timedelta(hours=-6))
    Authority(tmp_path).issue("robot1")
    finding = only(check_certificate(place(tmp_path)))
    assert finding.result is Result.FAIL
    assert finding.seen.startswith(f"this machine's certificate {tmp_path}/robot1.pem is not valid before ")
    assert "set this machine's clock" in finding.cure
    assert "'midspan keys make robot1 --replace'" in finding.cure

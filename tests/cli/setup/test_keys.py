"""``midspan keys``: certificates that TLS accepts, protected from other users, never overwritten unless requested."""

from __future__ import annotations

import json
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.cli.main import main
from bridge.config.model import Config
from bridge.doctor.check import Result
from bridge.doctor.checks import keys as key_checks
from bridge.hub.security import certificates
from bridge.hub.security.certificates import Authority, CertificateError, read_certificate, signer
from tests.doctor.parts import around, every, hub, only, results


def run(folder: Path, *words: str) -> int:
    return main(["keys", *words, "--folder", str(folder)])


def test_show_lists_the_certificates_that_make_created(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "keys"
    assert run(folder, "make", "robot1", "10.1.2.3", "robot1.lab") == 0
    output = capsys.readouterr().out
    assert "made the authority" in output
    assert f"{folder}/ca.pem {folder}/robot1.pem {folder}/robot1.key" in output
    assert "trusted: []" in output
    assert run(folder, "make", "operator1", "--days", "10") == 0
    assert "made the authority" not in capsys.readouterr().out
    assert {file.name: file.stat().st_mode & 0o777 for file in folder.iterdir()} == dict.fromkeys(
        [f"{name}.{end}" for name in ("ca", "robot1", "operator1") for end in ("pem", "key")], 0o600
    )
    assert folder.stat().st_mode & 0o777 == 0o700
    assert run(folder, "show", "--json") == 0
    certificates = {certificate["name"]: certificate for certificate in json.loads(capsys.readouterr().out)}
    assert certificates["robot1"]["names"] == ["robot1", "robot1.local", "10.1.2.3", "robot1.lab"]
    assert certificates["robot1"]["days_left"] in (729, 730)
    assert certificates["operator1"]["days_left"] in (9, 10)
    assert [certificate["authority"] for certificate in certificates.values()] == [True, False, False]
    assert run(folder, "show") == 0
    assert "(authority)" in capsys.readouterr().out


def test_show_accepts_a_folder_with_a_dot_in_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "keys.d"
    assert run(folder, "make", "robot1") == 0
    capsys.readouterr()
    assert run(folder, "show") == 0
    assert "robot1.pem" in capsys.readouterr().out


def snippet(text: str) -> dict[str, Any]:
    """Return the section ``hub.open`` of the configuration that 'make' prints, after checking the configuration."""
    lines = text.partition("in its configuration:\n")[2].splitlines()
    document = yaml.safe_load("\n".join(line for line in lines if line.startswith("  ")))
    Config.model_validate(document)
    settings: dict[str, Any] = document["hub"]["open"]
    return settings


def test_make_prints_what_a_listener_and_an_operator_need(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "make", "robot1", "192.168.1.20", "robot1.lab") == 0
    assert snippet(capsys.readouterr().out) == {"listen": ["tls/0.0.0.0:7448"], "trusted": []}
    (tmp_path / "note.pem").write_text("not a certificate")
    assert run(tmp_path, "make", "operator1") == 0
    text = capsys.readouterr().out
    assert snippet(text) == {"connect": ["tls/192.168.1.20:7448"], "trusted": ["robot1"]}
    assert "listen:" not in text
    assert "on robot1, so that it may command there: hub.open.trusted: [operator1]" in text
    assert run(tmp_path, "make", "base", "fe80::1") == 0
    assert "listen" in snippet(capsys.readouterr().out)
    assert run(tmp_path, "make", "operator1", "--replace") == 0
    places = ["tls/[fe80::1]:7448", "tls/192.168.1.20:7448"]
    assert snippet(capsys.readouterr().out) == {"connect": places, "trusted": ["base", "robot1"]}


def test_keys_of_an_operator_are_made_before_the_robots_address_is_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The address that the operator connects to is not known yet."""
    assert run(tmp_path, "make", "operator1") == 0
    text = capsys.readouterr().out
    assert snippet(text) == {"connect": ["tls/OTHER:7448"], "trusted": []}
    assert "# listen: [tls/0.0.0.0:7448]" in text


def test_openssl_accepts_the_certificates(tmp_path: Path) -> None:
    """As an independent program, OpenSSL checks the chain, the purposes of both ends, and the addresses."""
    authority = Authority(tmp_path)
    authority.make()
    authority.issue("robot1", ["10.1.2.3"])
    for more in (["-purpose", "sslserver", "-verify_ip", "10.1.2.3"], ["-purpose", "sslclient"], ["-x509_strict"]):
        command = ["openssl", "verify", "-CAfile", "ca.pem", *more, "robot1.pem"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    command = ["openssl", "verify", "-CAfile", "ca.pem", "-verify_ip", "10.9.9.9", "robot1.pem"]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode != 0


def test_files_are_not_overwritten_without_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "make", "robot1") == 0
    before = (tmp_path / "robot1.pem").read_bytes(), (tmp_path / "ca.pem").read_bytes()
    assert run(tmp_path, "make", "robot1") == 1
    assert "--replace" in capsys.readouterr().err
    assert (tmp_path / "robot1.pem").read_bytes() == before[0]
    assert run(tmp_path, "make", "robot1", "--replace") == 0
    assert (tmp_path / "robot1.pem").read_bytes() != before[0]
    assert (tmp_path / "ca.pem").read_bytes() == before[1]
    assert signer(tmp_path / "robot1.pem", tmp_path / "ca.pem") == read_certificate(tmp_path / "ca.pem")
    with pytest.raises(CertificateError, match="authority in"):
        Authority(tmp_path).make()


@pytest.mark.parametrize("name", ["ca", "../evil", "", "a b", "-x", "x" * 64])
def test_invalid_machine_names_are_refused(tmp_path: Path, name: str) -> None:
    Authority(tmp_path).make()
    with pytest.raises(CertificateError, match="not a machine's name"):
        Authority(tmp_path).issue(name)


@pytest.mark.parametrize(
    "address", ["tls/robot1:7448", "10.1.2.3:7448", "a..b", "*", "10.0.0.0/8", "räuber", "192.168.1.256", "192.168.1"]
)
def test_invalid_addresses_are_refused(tmp_path: Path, address: str) -> None:
    Authority(tmp_path).make()
    with pytest.raises(CertificateError, match="neither a host name nor an IP address"):
        Authority(tmp_path).issue("robot1", [address])
    assert not (tmp_path / "robot1.pem").exists()


@pytest.mark.parametrize("words", [["a/b"], ["ca"], ["robot1", "192.168.1.256"]], ids=" ".join)
def test_a_mistake_in_the_first_call_makes_no_authority(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    assert run(tmp_path / "keys", "make", *words) == 1
    assert "midspan: '" in capsys.readouterr().err
    assert not (tmp_path / "keys").exists()


def test_a_certificate_ends_with_its_authority(tmp_path: Path) -> None:
    authority = Authority(tmp_path).make(days=3)
    assert Authority(tmp_path).issue("robot1", days=1000).until == authority.until


def test_an_authority_that_cannot_sign_is_reported(tmp_path: Path) -> None:
    with pytest.raises(CertificateError, match="No such file"):
        Authority(tmp_path).issue("robot1")
    Authority(tmp_path).make()
    Authority(tmp_path / "other").make()
    (tmp_path / "ca.key").write_bytes((tmp_path / "other" / "ca.key").read_bytes())
    with pytest.raises(CertificateError, match=r"not the key of ca\.pem"):
        Authority(tmp_path).issue("robot1")
    (tmp_path / "ca.key").write_text("rubbish")
    with pytest.raises(CertificateError, match="cannot be used"):
        Authority(tmp_path).issue("robot1")
    with pytest.raises(CertificateError, match="is not a certificate"):
        read_certificate(tmp_path / "ca.key")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    Authority(tmp_path).make()
    Authority(tmp_path).issue("robot1")
    return tmp_path


def key_findings(folder: Path, **more: str) -> list[tuple[Result, str]]:
    opened = {"listen": ["tls/0.0.0.0:7448"], "keys": str(folder), **more}
    findings = every(key_checks.check_keys(around({"hub": {"open": opened}})))
    return [(finding.result, finding.seen) for finding in findings]


def test_doctor_accepts_valid_keys(folder: Path) -> None:
    ((result, seen),) = key_findings(folder)
    assert result is Result.OK
    assert "robot1" in seen
    assert results(key_checks.check_keys(around({}))) == [Result.SKIP]


def test_doctor_finds_what_is_wrong_with_the_files(folder: Path) -> None:
    (folder / "robot1.key").chmod(0o644)
    assert [result for result, _ in key_findings(folder)] == [Result.WARN]
    (folder / "robot1.key").chmod(0o600)
    Authority(folder / "other").make()
    ((result, seen),) = key_findings(folder, ca=str(folder / "other" / "ca.pem"))
    assert (result, "was not signed by" in seen) == (Result.FAIL, True)
    Authority(folder).issue("robot2")
    assert "certificate has the name 'robot2'" in key_findings(folder, certificate=str(folder / "robot2.pem"))[-1][1]
    (folder / "robot1.pem").unlink()
    ((result, seen),) = key_findings(folder)
    assert (result, "there is no" in seen) == (Result.FAIL, True)


def test_doctor_finds_a_key_that_does_not_fit(folder: Path) -> None:
    Authority(folder).issue("robot2")
    (folder / "robot1.key").write_bytes((folder / "robot2.key").read_bytes())
    ((result, seen),) = key_findings(folder)
    assert (result, seen) == (Result.FAIL, f"{folder / 'robot1.key'} is not the key of {folder / 'robot1.pem'}")
    (folder / "robot1.key").write_text("rubbish")
    ((result, seen),) = key_findings(folder)
    assert (result, seen.startswith(f"{folder / 'robot1.key'} cannot be used: ")) == (Result.FAIL, True)
    (folder / "robot1.key").unlink()
    (folder / "robot1.key").mkdir()
    assert key_findings(folder) == [(Result.FAIL, f"{folder / 'robot1.key'} is a folder, not a file")]


def test_doctor_checks_the_authority_of_this_machine_among_several(folder: Path, tmp_path: Path) -> None:
    """While an authority is replaced, `ca.pem` has both, and the former one may have expired."""
    Authority(tmp_path / "former").make(days=-1)
    former = (tmp_path / "former" / "ca.pem").read_bytes()
    (folder / "ca.pem").write_bytes(former + (folder / "ca.pem").read_bytes())
    assert [result for result, _ in key_findings(folder)] == [Result.OK]
    (folder / "ca.pem").write_bytes(former)
    assert [result for result, _ in key_findings(folder)] == [Result.FAIL, Result.FAIL], "expired, and did not sign"


def test_doctor_names_machines_that_refuse_commands(folder: Path) -> None:
    def router(daemon: str, name: str, *, trusted: bool) -> dict[str, Any]:
        return {"daemon": daemon, "worker": "router", "machines": [{"name": name, "trusted": trusted}]}

    view = hub(
        router("a", "robot1", trusted=True), router("b", "robot1", trusted=False), router("c", "other", trusted=False)
    )
    place = around({"hub": {"open": {"connect": ["tls/b:7448"], "keys": str(folder)}}}, hub=view)
    finding = only(key_checks.check_keys(place))
    assert finding.result is Result.WARN
    assert finding.seen.startswith("b accepts no commands")


@pytest.mark.parametrize(("days", "expected"), [(31, Result.OK), (20, Result.WARN)])
def test_doctor_warns_before_a_certificate_expires(folder: Path, days: int, expected: Result) -> None:
    Authority(folder).issue("robot1", days=days, replace=True)
    assert [result for result, _ in key_findings(folder)] == [expected]
    assert read_certificate(folder / "robot1.pem").until > datetime.now(UTC) + timedelta(days=days - 1)


def test_an_expired_certificate_is_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    certificate = Authority(folder).issue("robot1", ["192.168.1.20", "arm"], days=-1, replace=True)
    finding = only(
        key_checks.check_keys(around({"hub": {"open": {"listen": ["tls/0.0.0.0:7448"], "keys": str(folder)}}}))
    )
    since, until = f"{certificate.since:%Y-%m-%d}", f"{certificate.until:%Y-%m-%d %H:%M} UTC"
    assert finding.result is Result.FAIL
    assert finding.seen == (
        f"this machine's certificate {folder}/robot1.pem expired on {until} (it was valid from {since}):"
        " no machine accepts it"
    )
    assert finding.cure.startswith(f"set this machine's clock if it is not {datetime.now(UTC):%Y-%m-%d}")
    assert (
        "'midspan keys make robot1 192.168.1.20 arm --replace' on the machine with the authority's ca.key renews it"
    ) in finding.cure
    assert run(folder, "show") == 1
    assert "expired" in capsys.readouterr().out


@pytest.mark.parametrize("which", ["robot1", "ca"])
def test_a_certificate_that_is_not_valid_yet_is_reported(
    folder: Path, which: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for file in folder.glob("ca.*" if which == "ca" else "robot1.*"):
        file.unlink()
    with monkeypatch.context() as patch:
        patch.setattr(certificates, "_EARLIER", timedelta(hours=-6))  # made on a machine whose clock was ahead
        if which == "ca":
            Authority(folder).make()
        else:
            Authority(folder).issue(which)
    if which == "ca":
        Authority(folder).issue("robot1", replace=True)
    since = read_certificate(folder / f"{which}.pem").since
    text = f"not before {since:%Y-%m-%d %H:%M} UTC"
    ((result, seen),) = key_findings(folder)
    assert result is Result.FAIL
    owner = {"ca": "the authority", "robot1": "this machine"}[which]
    beginning = (
        f"{owner}'s certificate {folder / which}.pem is not valid before {since:%Y-%m-%d %H:%M} UTC (then until "
    )
    assert seen.startswith(beginning)
    assert run(folder, "show") == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.endswith(f"{which}.pem")]
    assert text in line
    assert run(folder, "show", "--json") == 1
    (shown,) = [
        certificate
        for certificate in json.loads(capsys.readouterr().out)
        if certificate["file"].endswith(f"{which}.pem")
    ]
    assert shown["since"] == since.isoformat()

"""How the files with the address of the name server are found, read and written."""

from __future__ import annotations

from pathlib import Path

import pytest

from yarp_compat.naming import config
from yarp_compat.naming.config import Address
from yarp_compat.ports.naming import NamingConfigError


@pytest.mark.parametrize(
    ("platform", "environment", "folder"),
    [
        ("linux", {"HOME": "/home/icub"}, "/home/icub/.config/yarp"),
        ("linux", {"HOME": "/home/icub", "XDG_CONFIG_HOME": "/x"}, "/x/yarp"),
        ("linux", {"HOME": "/home/icub", "XDG_CONFIG_HOME": "/x", "YARP_CONFIG_HOME": "/y"}, "/y"),
        ("darwin", {"HOME": "/Users/icub", "XDG_CONFIG_HOME": "/x"}, "/Users/icub/Library/Preferences/yarp"),
        ("darwin", {"HOME": "/Users/icub", "YARP_CONFIG_HOME": "/y"}, "/y"),
        ("win32", {"APPDATA": r"C:\Users\icub\AppData\Roaming"}, r"C:\Users\icub\AppData\Roaming\yarp\config"),
        ("win32", {"USERPROFILE": r"C:\Users\icub"}, r"C:\Users\icub\AppData\Roaming\yarp\config"),
        ("win32", {"APPDATA": r"C:\a", "YARP_CONFIG_HOME": r"D:\y"}, r"D:\y"),
    ],
)
def test_the_folder_depends_on_the_operating_system(platform: str, environment: dict[str, str], folder: str) -> None:
    """The folder is YARP's configuration folder."""
    assert config.folder(environment, platform) == folder


def test_a_written_file_is_read(tmp_path: Path) -> None:
    """The file equals YARP's; another network has its own file."""
    env = {"YARP_CONFIG_HOME": str(tmp_path / "made")}
    assert config.read(environment=env) is None
    path = config.write(Address("127.0.0.1", 10000), environment=env)
    assert path == tmp_path / "made" / "yarp.conf"
    assert path.read_text() == "127.0.0.1 10000 yarp\n"
    assert config.read(environment=env) == Address("127.0.0.1", 10000, "yarp")
    config.write(Address("10.0.0.1", 10100), "/my/robot", env)
    assert (tmp_path / "made" / "_my_robot.conf").read_text() == "10.0.0.1 10100 yarp\n"
    assert config.read("/my/robot", env) == Address("10.0.0.1", 10100)
    assert config.read(environment={**env, "YARP_NAMESPACE": "/my/robot"}) == Address("10.0.0.1", 10100)
    assert sorted(p.name for p in path.parent.iterdir()) == ["_my_robot.conf", "yarp.conf"]


def test_the_namespace_comes_from_environment_file_or_default(tmp_path: Path) -> None:
    """The environment overrides the file, and the file overrides ``/root``."""
    env = {"YARP_CONFIG_HOME": str(tmp_path)}
    assert config.namespace(env) == "/root"
    (tmp_path / config.NAMESPACE_FILE).write_text("/lab\n")
    assert config.namespaces(env) == ["/lab"]
    assert config.file(environment=env).name == "_lab.conf"
    assert config.namespaces({**env, "YARP_NAMESPACE": "/a /b"}) == ["/a", "/b"]


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1 10000 yarp\n", Address("127.0.0.1", 10000, "yarp")),
        ("  192.168.1.2\t10005", Address("192.168.1.2", 10005, "yarp")),
        ('"10.1.1.1" "10000"', Address("10.1.1.1", 10000, "yarp")),
        ("10.1.1.1 10000 local\n", Address("10.1.1.1", 10000, "local")),
        ("[name]\nhost icub-head\nport 10006\n", Address("icub-head", 10006, "yarp")),
        ("[name]\nport 10006 // old\nhost 10.1.1.1\nmode yarp\n[other]\nhost x\n", Address("10.1.1.1", 10006)),
    ],
)
def test_both_forms_of_the_file_are_parsed(text: str, address: Address) -> None:
    """One form is a line, the older one a group."""
    assert config.parse(text) == address


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("127.0.0.1", "expected '<address> <port> yarp'"),
        ("127.0.0.1 ten", "must be a number from 1 to 65535, not 'ten'"),
        ("127.0.0.1 0", "must be a number"),
        ("127.0.0.1 70000 yarp", "not '70000'"),
        ("127.0.0.1 " + "1" * 5000, "must be a number"),
        ("[name]\nhost x", "expected"),
        ("[nome]\nhost x\nport 1", "expected"),
    ],
)
def test_an_invalid_file_is_reported_with_its_path(tmp_path: Path, text: str, problem: str) -> None:
    """The error names the file, the problem and the expected format."""
    (tmp_path / "yarp.conf").write_text(text)
    with pytest.raises(NamingConfigError) as caught:
        config.read(environment={"YARP_CONFIG_HOME": str(tmp_path)})
    assert str(tmp_path / "yarp.conf") in str(caught.value)
    assert problem in str(caught.value)


def test_unreadable_and_unwritable_files_are_reported(tmp_path: Path) -> None:
    """The cases: a folder in place of the file, a file in place of the folder, and a file that is too large."""
    (tmp_path / "yarp.conf").mkdir()
    with pytest.raises(NamingConfigError, match="cannot read"):
        config.read(environment={"YARP_CONFIG_HOME": str(tmp_path)})
    (tmp_path / "plain").write_text("")
    with pytest.raises(NamingConfigError, match="cannot write"):
        config.write(Address("h", 1), environment={"YARP_CONFIG_HOME": str(tmp_path / "plain" / "yarp")})
    (tmp_path / "_big.conf").write_bytes(b"x" * 100_000)
    with pytest.raises(NamingConfigError, match="larger than"):
        config.read("/big", {"YARP_CONFIG_HOME": str(tmp_path)})

"""Migration of older files to the current keys: files that the project shipped, and other spellings of the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.config.document import ConfigError, parse
from bridge.config.load import loads
from bridge.config.migrate import migrate
from bridge.config.model import FORMAT

FILE = Path("midspan.yaml")

ROBOT = """\
# yaml-language-server: $schema=midspan.schema.json
#
# Two machines, the robot's side.

name: robot1

hub:
  # Beyond loopback: only with TLS where each shows its certificate.
  listen: tls/0.0.0.0:7447
  router_zenoh:
    transport:
      link:
        tls:
          root_ca_certificate: {folder}/ca.pem
          listen_certificate: {folder}/robot1.pem
          listen_private_key: {folder}/robot1.key
          enable_mtls: true
  zenoh:
    transport:
      link:
        tls:
          root_ca_certificate: {folder}/ca.pem
          connect_certificate: {folder}/robot1.pem
          verify_name_on_connect: false # the workers connect by address

ros1:
  enabled: true
  master: http://localhost:11311

routing:
  rules:
    - {{topic: /camera/**, rate: 5, depth: 2}}
"""
"""configs/two_machines_robot.yaml as it was before the hub had external listeners, without its command rule."""


def comments(text: str) -> list[str]:
    return [line.split("# ", 1)[1].strip() for line in text.splitlines() if "# " in line]


def test_the_robots_listener_moves_to_hub_open(tmp_path: Path) -> None:
    for name in ("ca.pem", "robot1.pem", "robot1.key"):
        (tmp_path / name).touch()
    old = ROBOT.format(folder=tmp_path)
    with pytest.raises(ConfigError, match="midspan config migrate"):
        loads(old)
    new = migrate(old, FILE)
    config = loads(new.text)
    assert (config.hub.listen, config.hub.open.listen) == ("tcp/127.0.0.1:7448", ("tls/0.0.0.0:7447",))
    door = config.hub.open
    assert [file and file.name for file in (door.ca, door.certificate, door.key)] == [
        "ca.pem", "robot1.pem", "robot1.key",
    ]  # fmt: skip
    assert (config.hub.zenoh, config.hub.router_zenoh, config.hub.open.trusted) == (None, None, ())
    assert config.routing == loads(old.replace("listen: tls/0.0.0.0:7447", "")).routing
    for comment in comments(old):
        assert comment in new.text
    assert [problem.key for problem in new.left] == ["hub.listen"]
    assert "hub.open.trusted" in str(new.left[0])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            "ros2:\n  # ours\n  build: true # as ever\n\n  domain: 7\n",
            "version: 1\nros2:\n  # ours\n  # build: true # as ever\n\n  domain: 7\n",
        ),
        ("ros2:\n  build: false\n# end\n", "version: 1\nros2:\n  # build: false\n# end\n"),
        ("ros2: {build: true, domain: 7} # one\n", "version: 1\nros2: {domain: 7} # one\n"),
        ("ros2: {domain: 7 , build: true}\n", "version: 1\nros2: {domain: 7}\n"),
        ("{ros2: {build: true}}\n", "{version: 1, ros2: {}}\n"),
        ("ros2:\n  build:\n  domain: 7", "version: 1\nros2:\n  # build:\n  domain: 7"),
        (
            "# A file.\n\n# The name.\nname: a\nros2:\n  build: >\n    tr\n    ue\n  domain: 7\n",
            "# A file.\n\nversion: 1\n# The name.\nname: a\nros2:\n  # build: >\n  #   tr\n  #   ue\n  domain: 7\n",
        ),
        ("", "version: 1\n"),
        ("# nothing\n", "# nothing\nversion: 1\n"),
        ("{}\n", "{version: 1}\n"),
        ("---\r\nros2: {build: true}\r\n", "---\r\nversion: 1\nros2: {}\r\n"),
        ("  name: robot1\n  hub: {domain: 3}\n", "  version: 1\n  name: robot1\n  hub: {domain: 3}\n"),
        ("# mine\n\n # the name\n  name: robot1\n", "# mine\n\n  version: 1\n # the name\n  name: robot1\n"),
        ("log:\n  level: debug\nversion: 1\n", "log:\n  level: debug\nversion: 1\n"),
        ("version: 1\nros2:\n  build: true\n", "version: 1\nros2:\n  # build: true\n"),
    ],
)
def test_a_removed_key_becomes_a_comment(old: str, new: str) -> None:
    migration = migrate(old, FILE)
    assert migration.text == new
    assert (migration.left, loads(new).version) == ([], FORMAT)
    assert migrate(new, FILE).text == new


def test_an_old_key_is_an_error_that_names_the_cure() -> None:
    with pytest.raises(ConfigError) as caught:
        loads("ros2:\n  build: true\n", FILE)
    fault = "is a key of an older Midspan; 'midspan config migrate' updates the file"
    assert str(caught.value) == f"midspan.yaml:2:3: ros2.build: {fault}"


def test_a_newer_format_is_refused_in_one_line() -> None:
    text = f"version: {FORMAT + 1}\nunheard: of\n"
    fault = (
        f"midspan.yaml:1:10: version: this file has format {FORMAT + 1}, and this Midspan reads up to {FORMAT};"
        " update Midspan, or use the file from before the update"
    )
    for refuse in (lambda: loads(text, FILE), lambda: migrate(text, FILE)):
        with pytest.raises(ConfigError) as caught:
            refuse()
        assert str(caught.value) == fault
    with pytest.raises(ConfigError, match="version: input should be greater than or equal to 1"):
        loads("version: 0")


@pytest.mark.parametrize(
    "old",
    [
        "ros2: {build: &it true, localhost_only: *it}\n",
        "ros2:\n  build: &it true\n  localhost_only: *it\n",
        "ros2: {localhost_only: &it true, build: *it}\n",
    ],
)
def test_the_content_of_an_anchor_is_left_unchanged_and_reported(old: str) -> None:
    migration = migrate(old, FILE)
    assert migration.text == f"version: 1\n{old}"
    assert [problem.key for problem in migration.left] == ["ros2.build"]


def test_the_reason_why_a_key_cannot_be_edited_is_reported() -> None:
    (problem,) = migrate("ros2: {build: true # c\n , domain: 3}\n", FILE).left
    assert "cannot edit this" in problem.text
    assert "edit it by hand" in problem.text
    assert "anchor" not in problem.text


def test_an_empty_certificate_is_not_moved() -> None:
    tls = "{root_ca_certificate: null, listen_certificate: a.pem}"
    old = f"hub: {{listen: 'tls/0.0.0.0:7000', router_zenoh: {{transport: {{link: {{tls: {tls}}}}}}}}}\n"
    assert "open: {listen: ['tls/0.0.0.0:7000'], certificate: 'a.pem'}" in migrate(old, FILE).text


def test_an_alias_on_a_line_of_its_own_goes_with_its_key() -> None:
    old = "ros2:\n  localhost_only: &it true\n  build: *it\n"
    assert migrate(old, FILE).text == "version: 1\nros2:\n  localhost_only: &it true\n  # build: *it\n"


def test_a_listener_of_all_interfaces_moves_to_hub_open_or_is_left() -> None:
    plain = migrate("hub: {listen: tcp/0.0.0.0:7447, domain: 3}\n", FILE)
    assert plain.text == (
        "version: 1\nhub: {open: {listen: ['tcp/0.0.0.0:7447']}, listen: tcp/127.0.0.1:7448, domain: 3}\n"
    )
    with pytest.raises(ConfigError, match="has no TLS"):
        loads(plain.text)
    other = migrate("hub:\n  listen: tls/0.0.0.0:7000\n", FILE)
    assert other.text == "version: 1\nhub:\n  open: {listen: ['tls/0.0.0.0:7000']}\n  # listen: tls/0.0.0.0:7000\n"
    old = "hub:\n  listen: tls/0.0.0.0:7447\n  open: {listen: [tls/0.0.0.0:7448]}\n"
    beside = migrate(old, FILE)
    assert (beside.text, [problem.key for problem in beside.left]) == (f"version: 1\n{old}", ["hub.listen"])


@pytest.mark.parametrize("text", ["- a\n", "text\n", "a: [\n", "a: 1\na: 2\n"])
def test_a_file_that_is_not_a_configuration_is_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        migrate(text, FILE)


@pytest.mark.parametrize(
    "text",
    [
        "a: [\n  1,  # in a list\n  2,\n]\n",
        "# before the start\n---\na: 1\n...\n",
        "a: 1\r\n# with CRLF\r\nb: 2\r\n",
        "a:\n- 1\nb:\n    -   c: 1  # other indents\n        d: 2\n",
        "a: { b:   1, c: [1,2,] }   \nlonger : 2\n",
        'a: "tab\\t \\u00e9 \\\n  folded"\nb: one\n  two\n',
        "a: ~\nb: True\nc: +1\nd: .NaN\ne: 1_0\n",
        "? a\n: 1",
        "# only\n\n# comments\n",
    ],
)
def test_all_other_text_stays_byte_for_byte(text: str) -> None:
    """The text contains what a round trip of ruamel.yaml 0.19 would change: moved or dropped comments, and styles."""
    assert migrate(text, FILE).text.replace(f"version: {FORMAT}\n", "", 1) == text


def test_the_shipped_files_need_nothing_but_their_version() -> None:
    for file in (Path(__file__).parents[2] / "configs").glob("*.yaml"):
        text = file.read_text(encoding="utf-8")
        migration = migrate(text, file)
        assert migration.left == []
        assert [line for line in migration.text.splitlines() if line != "version: 1"] == [
            line for line in text.splitlines() if line != "version: 1"
        ]
        assert parse(file, migration.text).data == {"version": 1} | parse(file, text).data

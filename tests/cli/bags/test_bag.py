"""``midspan bag`` as typed on the command line."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1

from bridge.bags.mcap_writer import ChannelInfo, McapWriter
from bridge.cli.main import main
from bridge.hub.graph.tokens import Origin
from tests.bags.foreign import CDR, Recorded, foreign_mcap
from tests.bags.written import START, long_mcap, mcap_bytes, mcap_file, nobody_knows, ros1_bag
from tests.support.wait import until

SECOND = 1_000_000_000
STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_info_describes_a_bag(capsys: pytest.CaptureFixture[str]) -> None:
    mcap_file(Path("run.mcap"))
    assert main(["bag", "info", "run.mcap"]) == 0
    shown = capsys.readouterr().out
    assert "run.mcap: mcap" in shown
    assert "compression zstd" in shown
    assert "1.9 s, 21 messages" in shown
    pose = next(line for line in shown.splitlines() if line.startswith("/pose"))
    assert pose.split() == ["/pose", "geometry_msgs/msg/PoseStamped", "20", "10.0", "ros2", "of", "robot1"]
    assert main(["bag", "info", "run.mcap", "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info["messages"], info["unfinished"], info["start"]) == (21, False, START / SECOND)
    assert {topic["name"]: topic["latched"] for topic in info["topics"]} == {"/map_name": True, "/pose": False}
    assert info["topics"][0]["metadata"]["daemon"] == "robot1"


def test_info_names_the_side_of_each_topic(capsys: pytest.CaptureFixture[str]) -> None:
    origins = {
        "/own": ("zenoh", None), "/json": ("zenoh_json", Origin("zenoh_json", "n", "robot1")),
        "/yarp": ("yarp", Origin("yarp", "n", "robot2")), "/foreign": ("", None),
    }  # fmt: skip
    with Path("run.mcap").open("wb", buffering=0) as stream:
        writer = McapWriter(stream)
        for topic, (side, origin) in origins.items():
            writer.channel(
                ChannelInfo(topic, "std_msgs/msg/String", definition="string data\n", side=side, origin=origin)
            )
        writer.finish()
    assert main(["bag", "info", "run.mcap"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("/")]
    assert {topic: columns for topic, _, _, _, *columns in lines} == {
        "/own": ["hub"], "/json": ["zenoh_json", "of", "robot1"], "/yarp": ["yarp", "of", "robot2"],
        "/foreign": ["ROS", "2"],
    }  # fmt: skip


def test_convert_prints_the_names_that_it_changes(capsys: pytest.CaptureFixture[str]) -> None:
    with Writer1("old.bag") as writer:
        topic = writer.add_connection("/camera/1", "std_msgs/msg/String", msgdef="string data\n", md5sum=STRING_MD5)
        writer.write(topic, START, b"\2\0\0\0hi")
    assert main(["bag", "convert", "old.bag", "new.mcap"]) == 0
    assert "renamed: /camera/1 is /camera/n1 in the new file" in capsys.readouterr().out
    assert main(["bag", "convert", "old.bag", "new.db3", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["renamed"] == {"/camera/1": "/camera/n1"}


def test_convert_prints_the_messages_that_it_cannot_read(capsys: pytest.CaptureFixture[str]) -> None:
    with Path("mixed.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schemas = {"json": writer.register_schema("state", "jsonschema", b"{}"), "cdr": 0}
        schemas["ros"] = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        for number, (name, schema) in enumerate(schemas.items()):
            channel = writer.register_channel(f"/{name}", "json" if name == "json" else "cdr", schema)
            writer.add_message(channel, number, b"\0\1\0\0\2\0\0\0a\0", number)
        writer.finish()
    assert main(["bag", "convert", "mixed.mcap", "new.db3"]) == 1
    assert "/cdr has no type: its channel has no schema; --skip-unknown leaves it out" in capsys.readouterr().err
    assert main(["bag", "convert", "mixed.mcap", "new.db3", "--skip-unknown"]) == 0
    shown = capsys.readouterr().out
    assert "new.db3: 1 message" in shown
    assert "not read: /json (json)" in shown
    assert "left out: /cdr has no type" in shown


def test_a_bag_is_converted_and_cut(capsys: pytest.CaptureFixture[str]) -> None:
    ros1_bag(Path("old.bag"))
    assert main(["bag", "convert", "old.bag", "new.mcap", "--topics", "/pose"]) == 0
    assert "new.mcap: 20 messages" in capsys.readouterr().out
    assert main(["bag", "cut", "new.mcap", "part.mcap", "--start", "500ms", "--end", str(START // SECOND + 1)]) == 0
    with AnyReader([Path("part.mcap")]) as bag:
        assert sum(1 for _ in bag.messages()) == 5


def test_info_shows_which_types_have_no_definition(capsys: pytest.CaptureFixture[str]) -> None:
    nobody_knows(Path("run.mcap"))
    assert main(["bag", "info", "run.mcap"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line.startswith("/")}
    assert {name: row.split("ROS 2")[1].strip() for name, row in rows.items()} == {
        "/known": "no definition",
        "/odd": "no definition",
    }
    mcap_file(Path("whole.mcap"))
    assert main(["bag", "info", "whole.mcap"]) == 0
    assert "no definition" not in capsys.readouterr().out


@pytest.mark.parametrize("target", ["new.db3", "new.mcap", "new"])
def test_convert_names_topics_without_a_definition(target: str, capsys: pytest.CaptureFixture[str]) -> None:
    odd, text = [CDR + bytes([number, 0, 0, 0]) for number in range(3)], [CDR + b"\3\0\0\0hi\0"]
    old = Recorded("/old", "std_msgs/msg/Bool", None, [CDR + b"\1"], {"topic_type_hash": "RIHS01_" + "ab" * 32})
    foreign_mcap(
        Path("run.mcap"), Recorded("/odd", "none_msgs/msg/None", None, odd), old,
        Recorded("/text", "std_msgs/msg/String", None, text),
    )  # fmt: skip
    assert main(["bag", "convert", "run.mcap", target]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{target}: 5 messages")
    names = [line for line in lines if line.startswith("copied without a definition, so that readers cannot decode")]
    assert [name.partition("it: ")[2].partition(")")[0] for name in names] == [
        "3 messages of /odd (none_msgs/msg/None", "1 message of /old (std_msgs/msg/Bool",
    ]  # fmt: skip
    assert sum("cure: " in line and "types.folders" in line for line in lines) == 2
    assert main(["bag", "convert", "run.mcap", "again.mcap", "--json", "--topics", "/odd"]) == 0
    undefined = json.loads(capsys.readouterr().out)["undefined"]
    assert {name: topic["messages"] for name, topic in undefined.items()} == {"/odd": 3}
    assert "none_msgs" in undefined["/odd"]["reason"]
    assert "types.folders" in undefined["/odd"]["cure"]


def test_types_from_the_configuration_are_used(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nobody_knows(Path("humble.mcap"))  # like a .db3 file of Humble, which has no definitions
    assert main(["bag", "convert", "humble.mcap", "a.db3"]) == 0
    assert main(["bag", "convert", "a.db3", "a.bag"]) == 1
    assert "/odd has type none_msgs/msg/None" in capsys.readouterr().err
    for package, text in {"none_msgs": "string<=9 text\n", "old_msgs": "string text\n"}.items():
        (folder / "types" / package / "msg").mkdir(parents=True)
        (folder / "types" / package / "msg" / "None.msg").write_text(text)
    Path("rules.yaml").write_text("- {ros1_package_name: old_msgs, ros2_package_name: none_msgs}\n", encoding="utf-8")
    Path("midspan.yaml").write_text("types: {folders: [types], mapping_rules: [rules.yaml]}\n", encoding="utf-8")
    assert main(["bag", "convert", "a.db3", "a.bag", "--config", "midspan.yaml"]) == 0
    with AnyReader([Path("a.bag")]) as bag:
        assert {c.topic: c.msgtype for c in bag.connections}["/odd"] == "old_msgs/msg/None"
        decoded: list[Any] = [bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages() if c.topic == "/odd"]
    assert [message.text for message in decoded] == ["hi"]


def test_unfinished_bag_is_reported_and_repaired(capsys: pytest.CaptureFixture[str]) -> None:
    Path("killed.mcap").write_bytes(mcap_bytes(100, finished=False)[:-30])
    assert main(["bag", "info", "killed.mcap"]) == 0
    assert "unfinished" in capsys.readouterr().out
    assert main(["bag", "mend", "killed.mcap", "whole.mcap", "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    with AnyReader([Path("whole.mcap")]) as bag:
        assert sum(1 for _ in bag.messages()) == info["messages"] > 50
    assert "byte" in info["damage"][0]


def test_a_file_of_a_folder_that_cannot_be_opened_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    Path("run").mkdir()
    mcap_file(Path("run/run_0.mcap"))
    Path("run/run_1.mcap").write_bytes(b"nothing of the kind")
    assert main(["bag", "info", "run"]) == 0
    assert "run/run_1.mcap, byte 0: is neither an MCAP file" in capsys.readouterr().out
    assert main(["bag", "mend", "run", "whole.mcap"]) == 0
    shown = capsys.readouterr().out
    assert "whole.mcap: 21 messages" in shown
    assert "not read: is neither an MCAP file nor a bag of ROS 1 or ROS 2 (run_1.mcap, byte 0)" in shown


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("info gone.mcap", "gone.mcap: file not found"),
        ("info text.bag", "text.bag, byte 0: is neither an MCAP file nor a bag"),
        ("convert a.mcap b.zip", "b.zip: has an unknown extension"),
        ("convert a.mcap a.mcap", "a.mcap: exists already"),
        ("convert a.mcap b.bag --topics /gone", "a.mcap: has no topic /gone"),
        ("cut a.mcap b.bag", "use 'midspan bag convert'"),
        ("cut a.mcap b.mcap --start 2s --end 1s", "--end is not after --start"),
    ],
)
def test_errors_are_reported(words: str, says: str, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    Path("text.bag").write_text("hello, this is a text", encoding="utf-8")
    mcap_file(Path("a.mcap"))
    assert main(["bag", *words.split()]) == 1
    assert says in capsys.readouterr().err
    assert sorted(path.name for path in folder.iterdir()) == ["a.mcap", "text.bag"]


def start_copy(verb: str, *before: str) -> subprocess.Popen[bytes]:
    """A copy that would take ten seconds and has just begun to write."""
    long_mcap(Path("a.mcap"), 1000, 50_000)
    assert main(["bag", "convert", "a.mcap", "a.bag"]) == 0
    command = [sys.executable, "-m", "bridge.cli.main", "bag", verb, "a.bag", "b.bag", "--compression", "bz2"]
    environ = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    process = subprocess.Popen([*before, *command], env=environ, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    until(lambda: any(path.name.startswith(".b.") for path in Path().iterdir()), what="the copy writes")
    return process


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("verb", ["convert", "cut", "mend"])
def test_interrupted_conversion_leaves_no_file(verb: str, number: int, code: int, folder: Path) -> None:
    process = start_copy(verb)
    process.send_signal(number)
    process.communicate(timeout=20)
    assert process.returncode == code
    assert sorted(path.name for path in folder.iterdir()) == ["a.bag", "a.mcap"]


def test_signals_during_cleanup_leave_no_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nobody_knows(Path("a.mcap"))
    remove, removed = shutil.rmtree, list[Path]()

    def interrupted(folder: Path, **more: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        remove(folder, **more)
        removed.append(folder)

    monkeypatch.setattr(shutil, "rmtree", interrupted)
    with pytest.raises(SystemExit) as ended:
        main(["bag", "convert", "a.mcap", "b.db3"])
    assert ended.value.code == 130
    assert len(removed) == 1
    assert sorted(path.name for path in folder.iterdir()) == ["a.mcap", "b.db3"]


def test_ignored_signal_does_not_end_the_conversion(folder: Path) -> None:
    process = start_copy("cut", "sh", "-c", "trap '' INT; exec \"$@\"", "sh")

    def written() -> int:
        return sum(path.stat().st_size for path in folder.glob(".b.*/b.bag"))

    process.send_signal(signal.SIGINT)
    before = written()
    until(lambda: written() > before, "the copy continues")
    process.terminate()
    process.communicate(timeout=20)
    assert process.returncode == 143


@pytest.mark.parametrize("name", ["b.bag", "b.mcap", "b.db3"])
def test_full_disk_is_reported_and_leaves_no_file(name: str, folder: Path) -> None:
    long_mcap(Path("a.mcap"), 100, 50_000)
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))\n"
        "from bridge.cli.main import main\n"
        f"sys.exit(main(['bag', 'convert', 'a.mcap', '{name}', '--compression', 'none']))"
    )
    environ = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run([sys.executable, "-c", code], env=environ, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert f"{name}: cannot be written: " in done.stderr
    assert sorted(path.name for path in folder.iterdir()) == ["a.mcap"]

"""The benchmarks run, and print and write the expected rows; the figures of these short runs are meaningless."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import bags, flood, many_topics, record, transcode, yarp_ports


@pytest.mark.thorough
def test_many_topics_arrive_and_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    many_topics.main(["--topics", "4", "--rate", "20", "--seconds", "1", "--parts", "busy", "--json", str(file)])
    rows = {row["case"]: row for row in json.loads(file.read_text())}
    for direction in ("ROS 1 to ROS 2", "ROS 2 to ROS 1"):
        arrived = rows[f"4 at 20 Hz, {direction}, arrived of sent"]
        assert arrived["ours"] == arrived["peer"] == 40
        assert rows[f"4 at 20 Hz, {direction}, p99, to the limit"]["ours"] > 0
        assert rows[f"4 at 20 Hz, {direction}, p99, to bare relays"]["peer"] > 0
    assert rows["4 at 20 Hz, CPU of both workers, to the limit"]["ours"] > 0


@pytest.mark.thorough
def test_flood_measures_with_and_without_the_stream(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    flood.main(["--way", "ros1", "--turns", "1", "--seconds", "0.5", "--json", str(file)])
    rows = {row["case"]: row for row in json.loads(file.read_text())}
    assert rows["/tf with 100 MB/s, ROS 1 to ROS 2, p99, against no stream"]["peer"] > 0
    assert rows["the stream, ROS 1 to ROS 2, arrived of sent"]["ours"] > 0


@pytest.mark.thorough
def test_record_is_compared_with_a_plain_subscriber(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    record.main(["--rounds", "1", "--seconds", "0.5", "--flow", "20e6", "--folder", str(tmp_path), "--json", str(file)])
    rows = {row["case"]: row for row in json.loads(file.read_text())}
    assert rows["messages lost"]["ours"] == 0
    assert rows["processor, none, against bare"]["ours"] > 0
    assert rows["latency p50 of small ones, against no recorder"]["peer"] > 0


@pytest.mark.thorough
def test_bags_are_compared_with_the_disk_and_zstd(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    bags.main(["--megabytes", "4", "--rounds", "1", "--cases", "images", "--json", str(file)])
    rows = {row["case"]: row for row in json.loads(file.read_text())}
    assert rows["cut images, mcap (disk)"]["peer"] > 0
    assert rows["convert images, bag to mcap zstd (zstd)"]["ours"] > 0
    assert rows["memory: convert images, bag to mcap zstd"]["ours"] > 10


@pytest.mark.parametrize("case", ["TFMessage of 20", "Image 1 MB"])
def test_transcode_is_compared_in_both_directions(case: str) -> None:
    name, values = transcode.CASES[case]
    rows = transcode.measure_case(case, name, values, rounds=1)
    assert {row.case.split(", ")[1] for row in rows} >= {"ROS 1 to CDR", "CDR to ROS 1"}
    assert len(rows) == (4 if case == "Image 1 MB" else 2)


def test_yarp_ports_are_compared_with_plain_sockets(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    yarp_ports.main(["--rounds", "1", "--share", "0.02", "--cores", "two", "--json", str(file)])
    rows = json.loads(file.read_text())
    assert len(rows) == 8
    assert all(row["ours"] > 0 and row["peer"] > 0 for row in rows)

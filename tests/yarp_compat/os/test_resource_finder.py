"""The folders in which `ResourceFinder` finds files, their order, and its command line."""

from __future__ import annotations

from pathlib import Path

import pytest

import yarp_compat as yarp


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Create all folders that YARP searches, empty."""
    folders = {name: tmp_path / name for name in ("here", "config", "data", "sysadmin", "installed", "bundle")}
    for path in folders.values():
        path.mkdir()
    monkeypatch.chdir(folders["here"])
    monkeypatch.setenv("YARP_CONFIG_HOME", str(folders["config"]))
    monkeypatch.setenv("YARP_DATA_HOME", str(folders["data"]))
    monkeypatch.setenv("YARP_CONFIG_DIRS", str(folders["sysadmin"]))
    monkeypatch.setenv("YARP_DATA_DIRS", str(folders["installed"]))
    monkeypatch.setenv("YARP_ROBOT_NAME", "r1")
    return folders


def write_file(folder: Path, name: str, text: str = "") -> str:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return str(path)


def finder(*arguments: str, context: str = "nav", main: str = "robot.ini") -> yarp.ResourceFinder:
    rf = yarp.ResourceFinder()
    rf.setDefaultContext(context)
    rf.setDefaultConfigFile(main)
    rf.configured = rf.configure(["program", *arguments])
    return rf


def test_files_are_searched_in_yarps_order_of_folders(places: dict[str, Path]) -> None:
    in_order = [
        write_file(places["here"], "map.txt"),
        write_file(places["data"], "robots/r1/map.txt"),
        write_file(places["installed"], "robots/r1/map.txt"),
        write_file(places["data"], "contexts/nav/map.txt"),
        write_file(places["sysadmin"], "contexts/nav/map.txt"),
        write_file(places["config"], "map.txt"),
        write_file(places["data"], "map.txt"),
        write_file(places["sysadmin"], "map.txt"),
        write_file(places["installed"], "map.txt"),
        write_file(places["bundle"], "map.txt"),
    ]
    write_file(places["installed"], "config/path.d/b.ini", f'[search b]\npath "{places["bundle"]}"\n')
    rf = finder()
    every = rf.findPaths("map.txt")
    assert [every.get(i).asString() for i in range(every.size())] == in_order
    for path in in_order:
        assert rf.findFileByName("map.txt") == path
        Path(path).unlink()
    assert rf.findFileByName("map.txt") == ""


def test_command_line_has_priority_over_the_file(places: dict[str, Path]) -> None:
    write_file(places["installed"], "contexts/nav/robot.ini", "speed 0.5\nname r1\n[LASER]\nport /laser\n")
    rf = finder("--speed", "0.9", "--verbose")
    assert rf.configured
    assert rf.isConfigured()
    assert rf.find("speed").asFloat64() == 0.9
    assert rf.find("name").asString() == "r1"
    assert rf.check("verbose")
    assert not rf.check("period")
    assert rf.check("period", yarp.Value(0.02)).asFloat64() == 0.02
    assert rf.findGroup("LASER").find("port").asString() == "/laser"
    assert rf.findGroup("ODOMETRY").isNull()
    nested = rf.findNestedResourceFinder("LASER")
    assert nested.find("port").asString() == "/laser"
    assert not nested.isNull()
    assert rf.findNestedResourceFinder("ODOMETRY").isNull()
    assert "(name r1)" in rf.toString()


def test_context_and_file_are_read_from_the_command_line(places: dict[str, Path]) -> None:
    write_file(places["installed"], "contexts/other/their.ini", "a 1\n")
    wanted = write_file(places["installed"], "contexts/other/table.txt")
    rf = finder("--context", "other", "--from", "their.ini", "--table", "table.txt")
    assert rf.configured
    assert rf.find("a").asInt32() == 1
    assert rf.getContext() == "other"
    assert rf.getContexts().toString() == "other"
    assert rf.findFile("table") == wanted  # the file that the option names
    assert rf.getContextPath() == str(places["installed"] / "contexts/other")


def test_a_missing_file_from_the_command_line_is_an_error(
    places: dict[str, Path], caplog: pytest.LogCaptureFixture
) -> None:
    assert finder().configured  # the default file may be missing
    assert not finder("--from", "missing.ini").configured
    assert "missing.ini" in caplog.text


def test_contexts_are_not_searched_if_the_main_file_is_in_the_current_folder(places: dict[str, Path]) -> None:
    write_file(places["here"], "robot.ini", "a 2\n")
    write_file(places["installed"], "contexts/nav/map.txt")
    rf = finder()
    assert rf.find("a").asInt32() == 2
    assert rf.findFileByName("map.txt") == ""  # as in YARP, contexts are not searched in this case
    assert rf.getHomeContextPath() == str(places["here"])


def test_user_folders_are_created(places: dict[str, Path]) -> None:
    rf = finder()
    assert rf.getHomeContextPath() == str(places["data"] / "contexts/nav")
    assert Path(rf.getHomeContextPath()).is_dir()
    assert rf.getHomeRobotPath() == str(places["data"] / "robots/r1")
    assert rf.findPath() == str(places["here"])


def test_options_choose_duplicates_and_places(places: dict[str, Path]) -> None:
    write_file(places["config"], "plugins/a.ini", "a 1\nb 1\n")
    write_file(places["installed"], "plugins/a.ini", "a 2\nc 2\n")
    options = yarp.ResourceFinderOptions(yarp.ResourceFinderOptions.Default, resourceType="plugins")
    rf = finder()
    assert rf.findFile("a.ini", options) == str(places["config"] / "plugins/a.ini")
    config = yarp.Property()
    options.duplicateFilesPolicy = yarp.ResourceFinderOptions.All
    assert rf.readConfig(config, "a.ini", options)
    assert (config.find("a").asInt32(), config.find("b").asInt32(), config.find("c").asInt32()) == (1, 1, 2)
    options.searchFlavor = yarp.ResourceFinderOptions.DataLike
    options.searchLocations = yarp.ResourceFinderOptions.User
    assert rf.findFile("a.ini", options) == ""


def test_absolute_paths_are_kept(places: dict[str, Path], tmp_path: Path) -> None:
    path = write_file(tmp_path, "x.txt")
    assert finder().findFileByName(path) == path
    assert finder().findFileByName(path + "y") == ""


def test_paths_are_not_normalized(places: dict[str, Path]) -> None:
    write_file(places["here"], "x.txt")
    write_file(places["here"], "maps/a.txt")
    write_file(places["data"], "contexts/nav/maps/b.txt")
    rf, current = finder(), str(places["here"])
    assert rf.findFile("./x.txt") == f"{current}/./x.txt"
    assert rf.findFile("maps/../x.txt") == f"{current}/maps/../x.txt"
    assert rf.findFile("x.txt/") == ""
    assert rf.findPath("maps/") == f"{current}/maps/"
    assert (
        rf.findPaths("maps").toString()
        == yarp.Bottle([f"{current}/maps", str(places["data"] / "contexts/nav/maps")]).toString()
    )
    assert rf.findPath("./maps") == f"{current}/./maps"
    assert [str(path) for path in rf.findPaths("")][:2] == [current, f"{current}/"]


def test_absolute_context_is_a_name_below_the_contexts(places: dict[str, Path]) -> None:
    elsewhere = write_file(places["bundle"], "table.txt")
    below = write_file(places["data"], f"contexts/{places['bundle']}/plan.txt".replace("//", "/"))
    rf = finder("--context", str(places["bundle"]))
    assert rf.findFile("table.txt") == ""
    assert rf.findPaths("table.txt").size() == 0
    assert rf.findFile("plan.txt") == below.replace("contexts/", "contexts//", 1)
    assert Path(elsewhere).exists()


def test_user_folder_of_a_context_is_not_normalized(places: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("YARP_DATA_HOME", f"{places['data']}/")
    assert finder(context="nav/").getHomeContextPath() == f"{places['data']}//contexts/nav/"
    assert finder(context="./mine").getHomeContextPath() == "./mine"
    assert (places["here"] / "mine").is_dir()


def test_files_next_to_a_main_file_with_a_path_are_found(places: dict[str, Path]) -> None:
    write_file(places["here"], "conf/robot.ini", "a 1\n")
    beside = write_file(places["here"], "conf/map.txt")
    rf = finder("--from", "./conf/robot.ini")
    assert rf.find("a").asInt32() == 1
    assert rf.getHomeContextPath() == f"{places['here']}/./conf"
    assert rf.findFile("map.txt") == beside.replace("/conf/", "/./conf/")


def test_older_forms_of_configure_still_work(places: dict[str, Path]) -> None:
    rf = yarp.ResourceFinder()
    assert rf.configure("YARP_POLICY", ["program", "--a", "1"])
    assert rf.configure(2, ["program", "--b", "2"])
    assert rf.configure(["--c", "3"], False)
    assert [rf.find(key).asInt32() for key in "abc"] == [1, 2, 3]
    with pytest.raises(TypeError, match=r"sys\.argv"):
        rf.configure("--a 1")
    assert yarp.ResourceFinder(rf).find("a").asInt32() == 1
    assert yarp.ResourceFinder.getResourceFinderSingleton() is yarp.ResourceFinder.getResourceFinderSingleton()


def test_defaults_apply_to_missing_keys(places: dict[str, Path]) -> None:
    rf = yarp.ResourceFinder()
    rf.setDefault("period", 0.02)
    rf.setDefault("robot", "r1")
    rf.setDefault("limits", "(1 2 3)")
    rf.configure(["program", "--robot", "cer"])
    assert rf.find("period").asFloat64() == 0.02
    assert rf.find("robot").asString() == "cer"
    assert rf.find("limits").asList().size() == 3

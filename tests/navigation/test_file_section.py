"""A changed file of a module, at a reload."""

from __future__ import annotations

import json
from pathlib import Path

from bridge.config.load import load
from tests.peers.hub.modules import Place
from tests.support.wait import until


def test_a_module_restarts_with_the_changed_values_of_its_file(tmp_path: Path) -> None:
    (ini := tmp_path / "mapper.ini").write_text("[MAP]\nmap_name attic\n[LOCALIZATION]\nuse_localization_from_tf 1\n")
    with Place(tmp_path / "state") as place:
        modules = {"mapper2d": {"enabled": True, "ini": str(ini)}, "base_control": {"enabled": True}}
        sections = {"hub": {"listen": place.hubs.endpoint}, "yarp": place.yarp_section(), "modules": modules}
        (file := tmp_path / "midspan.yaml").write_text(
            json.dumps({"name": "here", "state": str(place.folder), **sections})
        )
        place.worker.start(load(file))
        assert place.answer("mapper2d")["map"] == "attic"
        mapper, base = (place.worker.running(name).module for name in ("mapper2d", "base_control"))
        assert place.worker.reload(load(file))
        assert place.worker.running("mapper2d").module is mapper, "without a change, the module keeps running"
        ini.write_text(ini.read_text().replace("attic", "cellar"))
        assert place.worker.reload(load(file))
        until(lambda: (place.status("mapper2d") or {}).get("map") == "cellar", "the module has the file's new value")
        assert place.worker.running("base_control").module is base, "other modules keep running"

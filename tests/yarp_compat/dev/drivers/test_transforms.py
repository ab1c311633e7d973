"""The transform devices: transforms local to a program, and failures to open."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

import yarp_compat as yarp
from tests.yarp_compat.os.conftest import local
from yarp_compat.dev.frametransform_client import LIFETIME
from yarp_compat.dev.frametransform_local import LocalTransforms
from yarp_compat.dev.returnvalue import ReturnCode

__all__ = ["local"]


@pytest.fixture
def frames(local: None) -> Iterator[LocalTransforms]:
    driver = yarp.PolyDriver()
    assert driver.open_str("frameTransformClient"), "by default, the device needs no server, as in YARP"
    yield driver.viewIFrameTransform()
    driver.close()


def at(x: float) -> yarp.Matrix:
    matrix = yarp.Matrix(4, 4)
    matrix.eye()
    matrix[0, 3] = x
    return matrix


def test_local_transforms_are_stored_and_expire(frames: LocalTransforms, monkeypatch: pytest.MonkeyPatch) -> None:
    matrix, time = yarp.Matrix(), [100.0]
    for module in ("iframetransform", "frametransform_local"):
        monkeypatch.setattr(f"yarp_compat.dev.{module}.now", lambda: time[0])
    assert frames.setTransformStatic("base", "map", at(1.0))
    assert frames.setTransformStatic("laser", "base", at(0.5))
    assert frames.getTransform("laser", "map", matrix)
    assert matrix[0, 3] == 1.5
    assert frames.setTransform("arm", "base", at(0.25))
    assert frames.setTransform("arm", "base", at(0.75)), "a newer transform replaces an older one"
    assert frames.getTransform("arm", "base", matrix)
    assert matrix[0, 3] == 0.75
    time[0] += LIFETIME + 0.01
    assert not frames.frameExists("arm"), "the transform has expired"
    assert frames.frameExists("laser"), "static transforms do not expire"
    assert not frames.waitForTransform("arm", "map", 0.02)
    assert frames.waitForTransform("laser", "map", 0.02)
    assert frames.deleteTransform("base", "laser"), "the order of the two frames does not matter"
    assert frames.deleteTransform("laser", "base").code is ReturnCode.METHOD_FAILED
    assert frames.deleteTransform("*", "map")
    assert not frames.tree().transforms
    assert frames.setTransformStatic("base", "map", at(1.0))
    assert frames.clear()
    assert not frames.frameExists("base")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ("(config_name ftc_full_ros.xml)", "unknown config_name ftc_full_ros.xml"),
        ("(custom_config_from my.xml)", "files of devices are not supported; set config_name to ftc_yarp_only.xml"),
        ("(config_name ftc_yarp_only.xml)", "/frameTransformServer"),
        ("(ftc_storage_timeout long)", "'ftc_storage_timeout' of frameTransformClient must be a number, not long"),
        (
            "(config_name ftc_yarp_only.xml) (ftGet_client_enable_stream sometimes)",
            "must be true or false, not sometimes",
        ),
    ],
)
@pytest.mark.usefixtures("local")
def test_a_failed_open_logs_the_reason(caplog: pytest.LogCaptureFixture, options: str, reason: str) -> None:
    with caplog.at_level(logging.ERROR):
        driver = yarp.PolyDriver(yarp.Property(f"(device frameTransformClient) {options}"))
    assert not driver.isValid()
    assert reason in caplog.text

"""The client devices of cameras and language models (such as `*_nwc_yarp`), with servers of several releases."""

# ruff: noqa: ARG002 - names and arguments are YARP's

from __future__ import annotations

import threading
from contextlib import ExitStack, closing
from typing import Any

import pytest

import yarp_compat as yarp
from tests.support.wait import until
from tests.yarp_compat.dev.drivers.conftest import Serve
from yarp_compat.dev.framegrabber import BusType, CameraDescriptor, FeatureMode, FrameGrabberClient, FrameGrabberMsgs
from yarp_compat.dev.llm import ILLMMsgs, LLM_Message
from yarp_compat.dev.returnvalue import OK, ReturnValue
from yarp_compat.pythonic import Server, Writer
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.values import Vocab

NAME = "a camera of the tests"


class Camera(FrameGrabberMsgs):
    """A YARP 4.0 camera whose zoom can be set."""

    def __init__(self) -> None:
        super().__init__()
        self.values, self.active, self.mode = [1.0, 0.0], True, FeatureMode.MODE_AUTO
        self.pushed = list[int]()

    def getCameraDescriptionRPC(self) -> tuple[ReturnValue, CameraDescriptor]:
        return OK, CameraDescriptor(BusType.BUS_USB, NAME)

    def hasFeatureRPC(self, feature: int) -> tuple[ReturnValue, bool]:
        return OK, feature == yarp.YARP_FEATURE_ZOOM

    hasOnOffRPC = hasAutoRPC = hasManualRPC = hasOnePushRPC = hasFeatureRPC

    def getFeature1RPC(self, feature: int) -> tuple[ReturnValue, float]:
        return OK, self.values[0]

    def setFeature1RPC(self, feature: int, value: float) -> ReturnValue:
        self.values[0] = value
        return OK

    def getFeature2RPC(self, feature: int) -> tuple[ReturnValue, float, float]:
        return OK, self.values[0], self.values[1]

    def setFeature2RPC(self, feature: int, value1: float, value2: float) -> ReturnValue:
        self.values = [value1, value2]
        return OK

    def getActiveRPC(self, feature: int) -> tuple[ReturnValue, bool]:
        return OK, self.active

    def setActiveRPC(self, feature: int, onoff: bool) -> ReturnValue:
        self.active = onoff
        return OK

    def getModeRPC(self, feature: int) -> tuple[ReturnValue, FeatureMode]:
        return OK, self.mode

    def setModeRPC(self, feature: int, mode: FeatureMode) -> ReturnValue:
        self.mode = mode
        return OK

    def setOnePushRPC(self, feature: int) -> ReturnValue:
        self.pushed.append(feature)
        return OK


def vocab_reply(camera: Camera, words: list[Any]) -> list[Any]:
    """Return the reply of a camera from before YARP 4.0 (``FrameGrabberControls_Responder``)."""
    match words:
        case ["fgc", "get", "camd"]:
            return [Vocab("fgc"), Vocab("camd"), Vocab("is"), int(BusType.BUS_USB), NAME]
        case ["fgc", "has", _, int(feature)]:
            return [Vocab("fgc"), Vocab("has"), Vocab("feat"), 0, int(camera.hasFeatureRPC(feature)[1])]
        case ["fgc", "get", "feat" | "fea2" | "actv" | "mode" as subject, int()]:
            values = {"feat": camera.values[:1], "fea2": camera.values, "actv": [int(camera.active)]}
            return [Vocab("fgc"), Vocab(subject), Vocab("is"), *values.get(subject, [int(camera.mode)])]
        case ["fgc", "set", "feat", int(), float(value)]:
            camera.values[0] = value
        case ["fgc", "set", "fea2", int(), float(first), float(second)]:
            camera.values = [first, second]
        case ["fgc", "set", "actv", int(), int(on)]:
            camera.active = bool(on)
        case ["fgc", "set", "mode", int(), int(mode)]:
            camera.mode = FeatureMode(mode)
        case ["fgc", "set", "onep", int(feature)]:
            camera.pushed.append(feature)
        case _:
            return [Vocab("fail")]
    return []


@pytest.mark.parametrize(
    ("version", "device", "port"),
    [
        ("4.0", "frameGrabber_nwc_yarp", "/camera/rpc"),
        ("3.9", "frameGrabber_nwc_yarp", "/camera/rpc"),
        ("3.9", "remote_grabber", "/camera/rpc"),
        ("3.9", "remote_grabber", "/camera"),
    ],
)
def test_camera_controls_are_read_and_set(serve: Serve, version: str, device: str, port: str) -> None:
    camera = Camera()
    with ExitStack() as ports:
        if version == "4.0":
            serve(port, camera)
        else:
            ports.enter_context(Server(port, lambda words: vocab_reply(camera, words)))
        options = f"(device {device}) (local /me) (remote /camera) (no_stream true)"
        driver = yarp.PolyDriver(yarp.Property(options))
        controls = driver.viewIFrameGrabberControls()
        zoom, gain = yarp.YARP_FEATURE_ZOOM, yarp.cameraFeature_id_t_YARP_FEATURE_GAIN
        assert (zoom, gain, yarp.YARP_FEATURE_INVALID) == (16, 8, -1)
        for query in (
            controls.hasFeature,
            controls.hasOnOff,
            controls.hasAuto,
            controls.hasManual,
            controls.hasOnePush,
        ):
            assert (query(zoom), query(gain)) == (True, False)
        assert controls.setFeature(zoom, 2)
        assert controls.getFeature(zoom) == 2.0
        first, second = yarp.DVector(1), yarp.DVector(1)
        assert controls.setFeature(zoom, 3.0, 0.5)
        assert controls.getFeature(zoom, first, second)
        assert (first, second) == ([3.0], [0.5])
        assert controls.getActive(zoom)
        assert controls.setActive(zoom, False)
        assert not controls.getActive(zoom)
        assert controls.getMode(zoom) == yarp.MODE_AUTO
        assert controls.setMode(zoom, yarp.MODE_MANUAL)
        assert camera.mode == yarp.FeatureMode_MODE_MANUAL
        assert controls.setOnePush(zoom)
        assert camera.pushed == [16]
        about = yarp.CameraDescriptor()
        assert controls.getCameraDescription(about)
        assert (about.busType, about.deviceDescription) == (yarp.BUS_USB, NAME)
        assert controls.busType2String(about.busType) == "USB"
        assert controls.toFeatureMode(True) == yarp.MODE_AUTO
        assert driver.viewIFrameGrabberImage() is None, "the option no_stream is set"
        driver.close()
        assert not controls.setFeature(zoom, 1.0)
        assert controls.getFeature(zoom) == 0.0
        assert controls.getMode(zoom) == yarp.MODE_UNKNOWN


def test_a_camera_receives_images_until_it_is_closed(serve: Serve) -> None:
    serve("/camera/rpc", Camera())
    with Writer("/camera") as out:
        driver = yarp.PolyDriver(yarp.Property("(device frameGrabber_nwc_yarp) (local /me) (remote /camera)"))
        view, seen = driver.viewIFrameGrabberImage(), yarp.ImageRgb()
        sent = yarp.ImageRgb()
        sent.resize(4, 3)
        sent.setPixel(1, 2, yarp.PixelRgb(200, 100, 50))
        assert (view.width(), view.height()) == (0, 0)
        out.write(sent)
        assert view.getImage(seen)
        assert (view.width(), view.height()) == (4, 3)
        assert seen.numpy()[2, 1].tolist() == [200, 100, 50]
        ended = list[Any]()
        waiting = threading.Thread(target=lambda: ended.append(view.getImage(seen)))
        waiting.start()
        driver.close()
        until(lambda: ended, "the pending getImage ends")
        waiting.join()
        assert not ended[0]


def test_a_camera_continues_after_its_server_has_restarted(name_server: object) -> None:
    """Its images, and the controls of a server before 4.0, which have no method to call."""
    camera, sent, seen = Camera(), yarp.ImageRgb(), yarp.ImageRgb()
    sent.resize(4, 3)

    def start(servers: ExitStack) -> Writer:
        servers.enter_context(Server("/camera/rpc", lambda words: vocab_reply(camera, words)))
        return servers.enter_context(Writer("/camera"))

    with ExitStack() as first:
        start(first)
        client = FrameGrabberClient("/camera", "/me").open()
        images = client._reader
        assert images is not None
    with ExitStack() as second, closing(client):
        out = start(second)
        until(lambda: out.write(sent) and len(images), "the images continue")
        assert client.getImage(seen)
        until(lambda: client.setFeature(yarp.YARP_FEATURE_ZOOM, 2.0), "the controls are reached again")
        assert camera.values[0] == 2.0


def test_an_old_camera_that_does_not_reply_is_not_waited_for(name_server: object) -> None:
    replying, release = threading.Event(), threading.Event()

    def reply(words: list[Any]) -> list[Any]:
        if words[:1] == ["fgc"]:
            replying.set()
            release.wait(40)
        return [Vocab("fail")]

    with Server("/camera/rpc", reply), FrameGrabberClient("/camera", "/me", stream=False, timeout=40.0) as client:
        client._channel._timeout = 0.2
        until(lambda: not client.hasFeature(yarp.YARP_FEATURE_ZOOM) and replying.is_set(), "the camera is asked")
        assert not release.is_set()
        release.set()


class Model(ILLMMsgs):
    """A model that repeats each question in capital letters."""

    def __init__(self) -> None:
        super().__init__()
        self.messages = list[LLM_Message]()

    def setPrompt(self, prompt: str) -> ReturnValue:
        self.messages = [LLM_Message("system", prompt)]
        return OK

    def readPrompt(self) -> tuple[ReturnValue, str]:
        return OK, self.messages[0].content

    def ask(self, question: str) -> tuple[ReturnValue, LLM_Message]:
        answer = LLM_Message("function", question.upper(), ["place"], ["kitchen"])
        self.messages += [LLM_Message("user", question), answer]
        return OK, answer

    def getConversation(self) -> tuple[ReturnValue, list[LLM_Message]]:
        return OK, self.messages

    def deleteConversation(self) -> ReturnValue:
        self.messages = []
        return OK


@pytest.mark.parametrize("version", ["3.12", "4.0"])
def test_a_model_answers_and_keeps_the_conversation(serve: Serve, version: str) -> None:
    serve("/llm/rpc", Model(), Generation.of(version))
    driver = yarp.PolyDriver(yarp.Property("(device LLM_nwc_yarp) (local /me/rpc) (remote /llm/rpc)"))
    model, prompt = driver.viewILLM(), yarp.SVector(1)
    assert model.setPrompt("be short")
    assert model.readPrompt(prompt)
    assert prompt == ["be short"]
    answer, conversation = yarp.LLM_Message(), yarp.LLMVector(1)
    assert conversation == [LLM_Message()]
    assert model.ask("where", answer)
    assert answer == LLM_Message("function", "WHERE", ["place"], ["kitchen"])
    assert answer.toString_c() == "function WHERE (place) (kitchen)"
    assert model.getConversation(conversation)
    assert [message.content for message in conversation] == ["be short", "where", "WHERE"]
    assert model.deleteConversation()
    assert not model.refreshConversation(), "the model does not implement it"
    driver.close()

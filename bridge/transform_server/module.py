"""The hosted module of the transform server."""

from __future__ import annotations

from typing_extensions import override

from bridge.config.sections.section import Section
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.transforms import FrameSubscriptions
from bridge.status import Part
from bridge.tf.buffer import TransformBuffer
from bridge.tf.stamped import TF, TF_STATIC, TF_TYPE
from bridge.transform_server.buffer_server import BufferServer
from bridge.transform_server.exchange import Exchange
from bridge.transform_server.section import TransformServerSection
from bridge.transform_server.view import View, YarpClock
from bridge.transform_server.yarp_ports import FrameStream, Getter, Setter
from bridge.worker import Health
from yarp_compat.dev.frametransform import GET, SERVER, SET, STREAM


class TransformServer(Module):
    """A replacement for YARP's `frameTransformServer`, with the frames of all sides."""

    name = "transform_server"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, TransformServerSection)
        self._section = section
        clock = YarpClock(host.clock, on_run_clock=section.clock == "run")
        self._buffer = TransformBuffer(section.cache_time, max_future=section.max_future, now=host.clock.now_ns)
        self._view = View(clock.now, section.yarp_frame_lifetime, section.ros_frame_lifetime)
        tf = host.node.publisher(TF, TF_TYPE, Qos(depth=100))
        tf_static = host.node.publisher(TF_STATIC, TF_TYPE, LATCHED, priority="state")
        self._exchange = Exchange(self._buffer, self._view, clock, tf.publish_cdr, tf_static.publish_cdr)

        FrameSubscriptions(host.node, self._exchange.receive)
        host.on_jump(self._exchange.forget_timed)

        self._served = BufferServer(host.node, self._buffer) if section.buffer_server else None

        ports = section.prefix + SERVER
        generations = host.yarp.generations
        stream = FrameStream(
            host.yarp.output(ports + STREAM),
            self._exchange.frames,
            lambda profile: generations.of("", profile).generation,
            section.period,
        )
        host.yarp.serve(ports + SET, Setter(self._exchange, lambda: host.loop.post(stream.changed)))
        host.yarp.serve(ports + GET, Getter(self._exchange))
        host.loop.every(section.period, stream.tick)

    @override
    def reload(self, section: Section) -> bool:
        """Apply changed lifetimes at run time; other changes need a restart."""
        assert isinstance(section, TransformServerSection)
        lifetimes = {
            "yarp_frame_lifetime": section.yarp_frame_lifetime,
            "ros_frame_lifetime": section.ros_frame_lifetime,
        }
        if self._section.model_copy(update=lifetimes) != section:
            return False
        self._section = section
        self._view.yarp_lifetime, self._view.ros_lifetime = lifetimes.values()
        return True

    @override
    def health(self) -> Health:
        return Health("running", f"{len(self._view)} frames, {self._view.ours} of YARP programs")

    @override
    def status(self) -> Part:
        return Part(
            frames=len(self._view),
            frames_of_yarp=self._view.ours,
            lookups=self._served.status() if self._served is not None else {},
            refused=dict(self._buffer.refused),
            ignored=dict(self._exchange.ignored + self._view.left_out),
            conflicts=[
                {
                    "frame": info.name,
                    "parents": sorted(info.parents),
                    "sources": sorted({s.authority for s in info.sources}),
                }
                for info in self._buffer.conflicts()
            ],
        )

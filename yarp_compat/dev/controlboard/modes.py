"""Modes and types of joints: vocabs as numbers (`yarp/dev/IControlMode.h`, `IInteractionMode.h`, `IAxisInfo.h`)."""

from __future__ import annotations

from yarp_compat.os.data.vocab import Vocab32

VOCAB_CM_IDLE = Vocab32.encode("idl")
VOCAB_CM_TORQUE = Vocab32.encode("torq")
VOCAB_CM_POSITION = Vocab32.encode("pos")
VOCAB_CM_POSITION_DIRECT = Vocab32.encode("posd")
VOCAB_CM_VELOCITY = Vocab32.encode("vel")
VOCAB_CM_VELOCITY_DIRECT = Vocab32.encode("veld")
VOCAB_CM_CURRENT = Vocab32.encode("icur")
VOCAB_CM_PWM = Vocab32.encode("ipwm")
VOCAB_CM_IMPEDANCE_POS = Vocab32.encode("impo")
VOCAB_CM_IMPEDANCE_VEL = Vocab32.encode("imve")
VOCAB_CM_MIXED = Vocab32.encode("mix")
VOCAB_CM_FORCE_IDLE = Vocab32.encode("fidl")
VOCAB_CM_HW_FAULT = Vocab32.encode("hwfa")
VOCAB_CM_CALIBRATING = Vocab32.encode("cal")
VOCAB_CM_CALIB_DONE = Vocab32.encode("cald")
VOCAB_CM_NOT_CONFIGURED = Vocab32.encode("cfgn")
VOCAB_CM_CONFIGURED = Vocab32.encode("cfgy")
VOCAB_CM_UNKNOWN = Vocab32.encode("unkw")

VOCAB_IM_STIFF = Vocab32.encode("stif")
VOCAB_IM_COMPLIANT = Vocab32.encode("comp")
VOCAB_IM_UNKNOWN = Vocab32.encode("unkn")

VOCAB_JOINTTYPE_REVOLUTE = Vocab32.encode("atrv")
VOCAB_JOINTTYPE_PRISMATIC = Vocab32.encode("atpr")
VOCAB_JOINTTYPE_UNKNOWN = Vocab32.encode("unkn")

"""Constants of YARP's bindings: vocabs of old protocols, tags, features of cameras.

The values are those of the headers of 3.9.1, 3.12.3 and 4.0.0 (`yarp/dev/*.h`, `yarp/os/Bottle.h`), which agree.
"""

from __future__ import annotations

from functools import cache

from yarp_compat.wire import tags
from yarp_compat.wire.profile import Profile

_VOCABS = """
    AMP_CURRENT=acu AMP_CURRENTS=acus AMP_DISABLE=adi AMP_ENABLE=aen AMP_MAXCURRENT=maxc AMP_NOMINAL_CURRENT=acno
    AMP_PEAK_CURRENT=acpk AMP_PWM=pwm AMP_PWM_LIMIT=pwml AMP_STATUS=asta AMP_STATUS_SINGLE=asts
    AMP_VOLTAGE_SUPPLY=avsu BEMF=bmf CM_CONTROL_MODE=cmod CM_CONTROL_MODES=cmds CM_CONTROL_MODE_GROUP=cmog
    CURRENTCONTROL_INTERFACE=icur CURRENT_RANGE=rng CURRENT_RANGES=rngs CURRENT_REF=ref CURRENT_REFS=refs
    CURRENT_REF_GROUP=refg ENCODER=enc ENCODERS=encs ENCODER_ACCELERATION=eac ENCODER_ACCELERATIONS=eacs
    ENCODER_SPEED=esp ENCODER_SPEEDS=esps E_RESET=ere E_RESETS=eres GEARBOX_RATIO=gbxr IANALOG=iana
    ICONTROLMODE=icmd IJOINTFAULT=ijfl IMAP=imap IMAP_CLEAR_ALL_MAPS=clr IMAP_ERROR=err IMAP_GET_MAP=get
    IMAP_GET_NAMES=nams IMAP_LOAD_X=load IMAP_LOCATIONS_COLLECTION=locs IMAP_MAPS_COLLECTION=maps IMAP_OK=okk
    IMAP_REMOVE=remv IMAP_SAVE_X=save IMAP_SET_MAP=set IMPEDANCE=iimp IMP_OFFSET=iof IMP_PARAM=ipr INAVIGATION=inav
    INFO_NAME=name INFO_TYPE=type INTERACTION_MODE=mode INTERACTION_MODES=mods INTERACTION_MODE_GROUP=modg
    INTERFACE_INTERACTION_MODE=intm ITRANSFORM=itrf JF_GET_JOINTFAULT=jhfl LIMITS=llim LIST_VARIABLES=lvar
    MOTION_DONE_GROUP=dong MOTORS_NUMBER=mtnm MOTOR_CPR=mcpr MOTOR_ENCODER=mnc MOTOR_ENCODERS=mncs
    MOTOR_ENCODER_ACCELERATION=mac MOTOR_ENCODER_ACCELERATIONS=macs MOTOR_ENCODER_NUMBER=mnum
    MOTOR_ENCODER_SPEED=msp MOTOR_ENCODER_SPEEDS=msps MOTOR_E_RESET=mre MOTOR_E_RESETS=mres MOTOR_PARAMS=mtps
    NAV_AREA=area NAV_CLEARALL_X=clr NAV_DELETE_X=del NAV_GET_ABS_TARGET=gabs NAV_GET_CURRENT_POS=gpos
    NAV_GET_CURRENT_POSCOV=gcov NAV_GET_CURRENT_WAYPOINT=way NAV_GET_ESTIMATED_ODOM=godm NAV_GET_LIST_X=list
    NAV_GET_LOCALIZER_POSES=lpss NAV_GET_LOCALIZER_STATUS=lsts NAV_GET_NAME_TARGET=gnam
    NAV_GET_NAVIGATION_STATUS=nsts NAV_GET_NAVIGATION_WAYPOINTS=ways NAV_GET_NAV_MAP=nmap NAV_GET_REL_TARGET=grel
    NAV_GET_X=get NAV_GOTOABS=sabs NAV_GOTOABS_AND_NAME=sabn NAV_GOTOREL=srel NAV_LOCALIZATION_START=lcgo
    NAV_LOCALIZATION_STOP=lcst NAV_LOCATION=loc NAV_PATH=path NAV_RECOMPUTE_PATH=rcmp NAV_RENAME_X=renm
    NAV_RESUME=resm NAV_SET_INITIAL_POS=ipos NAV_SET_INITIAL_POSCOV=icov NAV_STOP=stop NAV_STORE_X=stor
    NAV_SUSPEND=susp NAV_TEMPORARY_FLAGS=tflg NAV_VELOCITY_CMD=velc PID=pid PIDCONTROL_INTERFACE=ipid
    PIDCONTROL_SET_FEEDFORWARD=pffd PIDCONTROL_SET_OFFSET=poff PIDS=pids PIXEL_ENCODING_BAYER_BGGR16=bg16
    PIXEL_ENCODING_BAYER_BGGR8=bggr PIXEL_ENCODING_BAYER_GBRG16=gb16 PIXEL_ENCODING_BAYER_GBRG8=gbrg
    PIXEL_ENCODING_BAYER_GRBG16=gr16 PIXEL_ENCODING_BAYER_GRBG8=grbg PIXEL_ENCODING_BAYER_RGGB16=rg16
    PIXEL_ENCODING_BAYER_RGGB8=rggb PIXEL_YUV_411=yuvd PIXEL_YUV_420=yuva PIXEL_YUV_422=yuvc PIXEL_YUV_444=yuvb
    POSITION=pos POSITIONCONTROL_INTERFACE=ipos POSITIONDIRECTCONTROL_INTERFACE=ipod POSITION_DIRECT=dpo
    POSITION_DIRECTS=dpos POSITION_DIRECT_GROUP=dpog POSITION_MOVE_GROUP=posg PWMCONTROL_INTERFACE=ipwm
    PWMCONTROL_PWM_OUTPUT=pwm PWMCONTROL_PWM_OUTPUTS=pwms PWMCONTROL_REF_PWM=ref PWMCONTROL_REF_PWMS=refs RANGE=rng
    RANGES=rngs REF_ACCELERATION_GROUP=accg REF_SPEED_GROUP=velg RELATIVE_MOVE_GROUP=relg
    REMOTE_VARIABILE_INTERFACE=ivar STOP_GROUP=stog TEMPERATURE=tmp TEMPERATURES=tmps TEMPERATURE_LIMIT=tmpl
    TORQUE=torq TORQUECONTROL_INTERFACE=itrq TORQUES_DIRECT=dtq TORQUES_DIRECTS=dtqs TORQUES_DIRECT_GROUP=dtqg
    TORQUE_MODE=trqd TRANSFORM_DELETE=tfdl TRANSFORM_DELETE_ALL=tfda TRANSFORM_SET=tfst TRQ=trq TRQS=trqs
    VARIABLE=mvar VELOCITY=vel VELOCITYCONTROL_INTERFACE=ivel VELOCITY_MOVE=vmo VELOCITY_MOVES=vmos
    VELOCITY_MOVE_GROUP=vmog VEL_LIMITS=vlim VEL_PID=vpd VEL_PIDS=vpds
"""
"""``VOCAB_`` names and their vocabs; those of control modes are in `yarp_compat.dev.controlboard`."""

_FEATURES = (
    "BRIGHTNESS EXPOSURE SHARPNESS WHITE_BALANCE HUE SATURATION GAMMA SHUTTER GAIN IRIS FOCUS TEMPERATURE TRIGGER "
    "TRIGGER_DELAY WHITE_SHADING FRAME_RATE ZOOM PAN TILT OPTICAL_FILTER CAPTURE_SIZE CAPTURE_QUALITY MIRROR NUMBER_OF"
)
"""`cameraFeature_id_t`, from 0."""

_COUNTED = {
    "BUS_": "UNKNOWN FIREWIRE USB",
    "MODE_": "UNKNOWN MANUAL AUTO",
    "MAS_": "OK ERROR OVF TIMEOUT WAITING_FOR_FIRST_READ UNKNOWN",
    "YARP_CROP_": "RECT LIST",
    "YARP_FEATURE_": _FEATURES,
    "PeriodicThreadClock_": "Relative Absolute",
    "ShouldUseSystemClock_": "No Yes",
}
"""Enumerations whose members are numbered from 0."""

_TAGS = "INT8 INT16 INT32 INT64 VOCAB32 VOCAB64 FLOAT32 FLOAT64 STRING BLOB LIST DICT"

VERSION = "4.0.0"
"""The release whose names are supported, in addition to those of 3.9; scripts read it as ``YARP_VERSION``."""


@cache
def table() -> dict[str, int | str]:
    """Return all constants by name."""
    constants: dict[str, int | str] = {
        "YARP_VERSION": VERSION,
        "YARP_VERSION_SHORT": VERSION,
        "YARP_FEATURE_INVALID": -1,
    }
    for name, value in zip(("MAJOR", "MINOR", "PATCH"), VERSION.split("."), strict=True):
        constants[f"YARP_VERSION_{name}"] = int(value)
    for entry in _VOCABS.split():
        name, vocab = entry.split("=")
        constants[f"VOCAB_{name}"] = int.from_bytes(vocab.encode().ljust(4, b"\0"), "little")
    for start, members in _COUNTED.items():
        constants.update({start + member: number for number, member in enumerate(members.split())})
    constants.update({f"BOTTLE_TAG_{name}": value for name, value in _bottle_tags().items()})
    return constants


def _bottle_tags() -> dict[str, int]:
    """Return the tags of YARP 3, which `Value.getCode` and `Bottle.getSpecialization` return; VOCAB64 is from 4.0."""
    profile = Profile.YARP3
    numbers = {"FLOAT32": profile.float32_tag, "FLOAT64": profile.float64_tag}
    return {name: numbers.get(name) or int(getattr(tags, name)) for name in _TAGS.split()}

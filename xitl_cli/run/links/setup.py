"""Setup of an autopilot: parameters and mission of a profile, and their upload to an agent before a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from agent.fcu.parameters import BY_NAME, SYSTEM_ID
from agent.mavlink.commands import StatusTextReceiver
from agent.mavlink.exchange import Target, complete
from agent.mavlink.missions import FENCE, MISSION, RALLY, MissionUpload, PlanItem, result_name, waypoint_items
from agent.mavlink.parameters import ParameterClient
from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from sim_core.noise import white_deviation
from xitl_cli.errors import UserError
from xitl_cli.profile.files.parameter_files import read_parameter_file
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.agents import MissionItemSpec
from xitl_cli.run.links.vessel_gains import vessel_gains
from xitl_cli.run.world.world import magnetic_field_ned_gauss

Plans = dict[int, list[PlanItem]]
"""Plans to upload, by their MAV_MISSION_TYPE, in the order of their upload."""
PLAN_KEYS = {MISSION: "mission", FENCE: "mission.fence", RALLY: "mission.rally"}
Send = Callable[[Any], object]
Receive = Callable[[float], list[Any]]
ANSWER_S = 1.0
MISSION_S = 5.0
TRIES = 4
LOSSY = "the link may lose too many frames: check the cable, and the address in the profile"
EXTERNAL_AHRS_PROTOCOL = 36  # SERIALn_PROTOCOL
SERIAL_PORTS = range(10)


# -- Parameters of a profile


def embedded_parameters(profile: RunProfile) -> dict[str, float]:
    """Return the parameters of the embedded autopilot. Later sources override earlier ones.

    The order is: parameter files, values from vessel, site, mission and sensors, values of the profile. Gains of a file
    override the gains that follow from the vessel.
    """
    values = parameter_file_values(profile.autopilot.parameter_files, embedded=True)
    if values.get(SYSTEM_ID) != profile.autopilot.system_id:  # a file of one vessel may serve other vessels
        values.pop(SYSTEM_ID, None)
    values = values | vessel_gains(profile.vehicle, profile.mission.speed_mps) | values
    north, east, _ = magnetic_field_ned_gauss(profile.site)
    values["COMPASS_DEC"] = math.atan2(east, north)
    values.update(_implied_parameters(profile, antenna=True))
    if profile.sensors is not None:
        gnss = profile.sensors.gnss
        values["EK3_POSNE_M_NSE"] = BY_NAME["EK3_POSNE_M_NSE"].nearest(gnss.horizontal_noise_m)
        values["EK3_GPSDRIFT_TC"] = BY_NAME["EK3_GPSDRIFT_TC"].nearest(gnss.drift_correlation_s)
        compass = profile.sensors.magnetometer
        noise_gauss = white_deviation(compass.noise_density_gaussprthz, compass.rate_hz)
        values["EK3_MAG_M_NSE"] = BY_NAME["EK3_MAG_M_NSE"].nearest(noise_gauss)
    return values | dict(profile.autopilot.parameters)


def live_parameters(profile: RunProfile) -> dict[str, float]:
    """Return the parameters of another autopilot that is running. Values in the profile override the implied values.

    A PX4 gets the values of its parameter files here too, because it reads no such files at its start.
    """
    if profile.autopilot.kind == "px4":
        files = parameter_file_values(profile.autopilot.parameter_files)
        mission = {"RO_SPEED_LIM": profile.mission.speed_mps, "NAV_ACC_RAD": profile.mission.acceptance_radius_m}
        return files | mission | dict(profile.autopilot.parameters)
    antenna = profile.autopilot.bridge.sensors is not None
    return _implied_parameters(profile, antenna) | dict(profile.autopilot.parameters)


def start_parameters(profile: RunProfile) -> dict[str, float]:
    """Return the parameters of an autopilot that the run starts: its files, then `live_parameters`. Raises UserError.

    A PX4 gets the parameters of the sensors only at its start, because most of them take effect after a restart.
    """
    values: dict[str, float] = {}
    if profile.autopilot.kind == "px4" and profile.sensors is not None:
        gnss = profile.sensors.gnss
        values["EKF2_GPS_DELAY"] = 1e3 * gnss.latency_s
        values |= _position("EKF2_IMU_POS", profile.sensors.imu.position_frd_m)
        values |= _position("EKF2_GPS_POS", gnss.antenna_frd_m)
    return values | parameter_file_values(profile.autopilot.parameter_files) | live_parameters(profile)


def parameter_file_values(names: Iterable[str], embedded: bool = False) -> dict[str, float]:
    """Return the values of parameter files. Later files override earlier ones. Raises UserError."""
    values: dict[str, float] = {}
    for name in names:
        values.update(read_parameter_file(name, embedded))
    return values


def parameter_file_text(values: dict[str, float]) -> str:
    """Return the text of a parameter file that an autopilot reads at its start."""
    return "".join(f"{name} {value:.9g}\n" for name, value in sorted(values.items()))


def serial_port_with(values: dict[str, float], protocol: int = EXTERNAL_AHRS_PROTOCOL) -> int | None:
    """Return the lowest serial port with this protocol, or None when there is none."""
    ports = (port for port in SERIAL_PORTS if values.get(f"SERIAL{port}_PROTOCOL") == protocol)
    return next(ports, None)


def _implied_parameters(profile: RunProfile, antenna: bool) -> dict[str, float]:
    values = {"WP_SPEED": profile.mission.speed_mps, "WP_RADIUS": profile.mission.acceptance_radius_m}
    if profile.sensors is not None:
        values.update(_position("INS_POS1", profile.sensors.imu.position_frd_m))
        if antenna:
            values.update(_position("GPS1_POS", profile.sensors.gnss.antenna_frd_m))
    return values


def _position(name: str, position_frd_m: tuple[float, float, float]) -> dict[str, float]:
    return {f"{name}_{axis}": value for axis, value in zip("XYZ", position_frd_m, strict=True)}


def mission_plans(profile: RunProfile, frame: LocalFrame) -> Plans:
    """Return fence, rally points and mission of the profile. Item 0 of the mission is home, the start of the vessel.

    A plan without items is left out, so that an autopilot keeps its stored plan.
    """
    mission = profile.mission
    plans: Plans = {}
    for mission_type, items in ((FENCE, mission.fence), (RALLY, mission.rally)):
        if items:
            plans[mission_type] = [_plan_item(frame, seq, item) for seq, item in enumerate(items)]
    course = mission_items(profile, frame)
    if len(course) > 1:
        plans[MISSION] = course
    return plans


def mission_items(profile: RunProfile, frame: LocalFrame) -> list[PlanItem]:
    """Return home, which is the start of the vessel, and the items of the mission."""
    mission = profile.mission
    start = mission.start
    points = [(start.north_m, start.east_m), *mission.waypoints_ned_m]
    lat, lon, alt = frame.geodetic(np.array([(north, east, 0.0) for north, east in points], dtype=float))
    plain = waypoint_items(zip(lat.tolist(), lon.tolist(), alt.tolist(), strict=True))
    return [*plain, *(_plan_item(frame, seq, item) for seq, item in enumerate(mission.items, start=1))]


def _plan_item(frame: LocalFrame, seq: int, item: MissionItemSpec) -> PlanItem:
    p1, p2, p3, p4 = (math.nan if value is None else value for value in item.parameters)
    lat_deg = lon_deg = 0.0
    if item.place_ned_m is not None:
        lat, lon, _ = frame.geodetic(np.array([[*item.place_ned_m, 0.0]]))
        lat_deg, lon_deg = float(lat[0]), float(lon[0])
    return PlanItem(seq, item.frame, item.command, (p1, p2, p3, p4), lat_deg, lon_deg, item.altitude_m)


# -- Upload to an agent; `receive(timeout_s)` returns the messages that arrived


def set_parameters(
    target: Target,
    values: dict[str, float],
    send: Send,
    receive: Receive,
    key: str = "autopilot",
    lossless: bool = False,
) -> None:
    """Set each parameter and check its value. `key`: group of the profile with the parameters. Raises UserError.

    lossless: the link loses nothing, so no request is repeated.
    """
    tries = 1 if lossless else TRIES
    client = ParameterClient(target, tries=tries, answer_s=TRIES * ANSWER_S / tries)
    joined = StatusTextReceiver()
    for name, value in values.items():
        texts: list[str] = []

        def receive_texts(timeout_s: float, texts: list[str] = texts) -> list[Any]:
            messages = receive(timeout_s)
            for message in messages:
                if message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT:
                    text = joined.handle(message)
                    texts += [] if text is None else [text]
            return messages

        request = client.set(name, value)
        complete(request, send, receive_texts)
        if request.answer is None:
            reason = (
                f"did not accept it: {texts[-1]}; check the name"
                if texts
                else f"did not answer in {TRIES * ANSWER_S:g} s; {LOSSY}"
            )
            raise UserError(f"{key}.parameters.{name}: the agent {reason}")
        actual = client.value(request.answer)
        if not math.isclose(actual, value, rel_tol=1e-6, abs_tol=1e-9):
            reason = f" ({texts[-1]})" if texts else ""
            raise UserError(f"{key}.parameters.{name} = {value:g}: the agent keeps {actual:g}{reason}")


def upload_plan(
    target: Target,
    items: Sequence[PlanItem],
    send: Send,
    receive: Receive,
    lossless: bool = False,
    mission_type: int = MISSION,
) -> None:
    """Upload a mission, a fence or rally points. Raises UserError when the agent refuses it or does not answer."""
    name = PLAN_KEYS[mission_type]
    give_up_s = TRIES * MISSION_S
    repeat_s = give_up_s if lossless else MISSION_S
    upload = MissionUpload(target, items, mission_type, repeat_s=repeat_s, give_up_s=give_up_s)
    complete(upload, send, receive)
    if upload.result is None:
        raise UserError(f"{name}: the agent did not answer until the end of the upload; {LOSSY}")
    if not upload.accepted:
        raise UserError(f"{name}: the agent refused it ({result_name(upload.result)})")

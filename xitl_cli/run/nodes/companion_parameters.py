"""What a companion is told of the vessel it is on."""

from __future__ import annotations

from sim_core.environment.water import Water
from sim_core.vessel.buoyancy import floating_draft_m
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.world.world import vessel_model


def parameters_of(profile: RunProfile) -> dict[str, float]:
    """What vessel, lidar and mission imply, then the profile's own."""
    assert profile.companion is not None
    hull = profile.vehicle.hull
    water = Water(**profile.environment.water.model_dump())
    values = {
        "HULL_LENGTH": hull.length_m,
        "HULL_WIDTH": hull.width_m,
        "HULL_WATER": hull.keel_below_cg_m - floating_draft_m(vessel_model(profile.vehicle), water),
        "WP_SPEED": profile.mission.speed_mps,
    }
    if profile.sensors is not None and profile.sensors.lidar is not None:
        values["LIDAR_YAW"] = profile.sensors.lidar.yaw_deg
    return values | dict(profile.companion.parameters)

"""What a robot carries, as a ball at each site of its description that holds a payload."""

from __future__ import annotations

import mujoco

from trueup.errors import ConfigError
from trueup.robots import RobotSpec

PREFIX = "trueup.payload."


def attach_payload(spec: mujoco.MjSpec, robot: RobotSpec, payload_kg: float) -> None:
    """Hang a payload [kg] on the model, where the robot's description says; nothing for 0 kg.

    A body of its own, so that links with given inertias and links whose shapes have masses carry it alike. It collides
    with nothing.

    Raises:
        ConfigError: a mass that is none, a robot that carries nothing, or a site that the model does not have.
    """
    if not 0 <= payload_kg < float("inf"):
        raise ConfigError("a payload needs a mass", got=f"{payload_kg} kg", expected=">= 0 kg")
    if payload_kg == 0:
        return
    if robot.payload is None:
        raise ConfigError(
            f"robot {robot.name!r} does not say where a payload hangs",
            hint="payload: {sites: [a site of the model]} in robot.yaml",
        )
    known = {site.name: site for site in spec.sites}
    for name in robot.payload.sites:
        if name not in known:
            raise ConfigError(f"the model has no site {name!r} for a payload", available=sorted(known))
        site = known[name]
        ball = site.parent.add_body(name=PREFIX + name, pos=site.pos)
        # Sites may be turned by any of MuJoCo's ways of writing rotations down.
        ball.quat, ball.alt = site.quat, site.alt
        ball.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[robot.payload.radius_m, 0, 0],
            pos=[0, 0, robot.payload.offset_m],
            mass=payload_kg,
            contype=0,
            conaffinity=0,
        )

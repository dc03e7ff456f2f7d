"""What MuJoCo Warp has room for: constraints beyond it are dropped, and it goes on."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from trueup.errors import DataError


def room_for(engine: Any, model: mujoco.MjModel) -> int:
    """Rows of constraints of one robot, for `put_data`: all that it can need, with as many contacts as Warp keeps.

    A row for each joint and tendon with dry friction, one for each with a limit, and those of the contacts: 1 without
    friction, else as many as the cone has dimensions, or twice one less where it is a pyramid.

    Args:
        engine: the module `mujoco_warp`.
        model: of the robot.

    Returns:
        The number of rows; Warp's own (64 of most models) if that is more.
    """
    own = engine.put_data(model, mujoco.MjData(model), nworld=1)
    rows = sum(
        int(np.count_nonzero(each))
        for each in (model.dof_frictionloss, model.tendon_frictionloss, model.jnt_limited, model.tendon_limited)
    )
    if not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        largest = int(np.concatenate([[0], model.geom_condim, model.pair_dim]).max())
        pyramid = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL and largest > 1
        rows += int(own.naconmax) * (2 * (largest - 1) if pyramid else largest)
    return max(rows, int(own.njmax))


def refuse_overflow(engine: Any, data: Any, robot: str, hint: str) -> None:
    """Refuse what was simulated without constraints for which there was no room.

    Args:
        engine: the module `mujoco_warp`.
        data: of the robots, after their steps.
        robot: its name.
        hint: what to do instead.

    Raises:
        DataError: some were dropped.
    """
    kinds = engine.OverflowType
    # A solver that ends at its limit of iterations has dropped nothing; MuJoCo says nothing of it either.
    found = kinds(int(np.bitwise_or.reduce(data.overflow.numpy()))) & ~(kinds.ITERATIONS | kinds.LS_ITERATIONS)
    if found:
        raise DataError(
            f"MuJoCo Warp had no room for all contacts and other constraints of {robot!r}, and dropped some",
            got=str(found.name).lower(),
            expected=f"at most {data.njmax} rows, and {data.naconmax // data.nworld} contacts",
            hint=hint,
        )

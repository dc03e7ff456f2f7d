"""Other people's fits of the same residual: `mujoco.sysid`, and scipy over batches of `mujoco.rollout`."""

from __future__ import annotations

import contextlib
import copy
import io
import logging
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout
from scipy.optimize import least_squares

from benchmarks.identify_cases import Case
from trueup.core.parameters import Parameter

THREADS = 2


@dataclass(frozen=True)
class Fit:
    """Where a fit ended.

    Attributes:
        values: parameter name -> value.
        evaluations: candidates simulated.
    """

    values: dict[str, float]
    evaluations: int


def has_sysid() -> bool:
    """Whether `mujoco.sysid` can be imported; what it needs does not come with MuJoCo."""
    from mujoco import sysid

    return hasattr(sysid, "optimize")


def fit_with_sysid(case: Case) -> Fit:
    """`mujoco.sysid.optimize` as its documentation shows it, with its default optimizer and tolerances."""
    from mujoco import sysid

    parameters = sysid.ParameterDict()
    for item in case.start:
        parameters.add(
            sysid.Parameter(
                item.name,
                nominal=item.value,
                min_value=item.low,
                max_value=item.high,
                modifier=lambda spec, own, item=item: _write(spec, item, float(own.value[0])),
            )
        )
    joints, motions = len(case.nominal.robot.joints), _Motions(case)
    sequences = sysid.ModelSequences(
        "robot",
        case.nominal.spec.copy(),
        [log.id for log in case.logs],
        list(motions.states),
        [
            sysid.TimeSeries(log.commanded().time_s, control)
            for log, control in zip(case.logs, motions.controls, strict=True)
        ],
        [sysid.TimeSeries(log.measured.time_s, log.measured["position"]) for log in case.logs],
        allow_missing_sensors=True,
    )

    def residual(_parameters, predicted, measured, _model, _return_all, *, state, **_):
        return motions.scale * (state[:, 1 : 1 + joints] - measured.data[1:]), predicted, predicted

    simulate = sysid.build_residual_fn(
        models_sequences=[sequences], modify_residual=residual, n_threads=THREADS, resample_true=False
    )
    evaluations = 0

    def counted(x, own):
        nonlocal evaluations
        evaluations += 1 if x.ndim == 1 else x.shape[1]
        return simulate(x, own)

    logging.getLogger("absl").setLevel(logging.ERROR)
    with contextlib.redirect_stdout(io.StringIO()):
        found, _ = sysid.optimize(initial_params=parameters, residual_fn=counted, verbose=False)
    return Fit(dict(zip(case.start.names, map(float, found.as_vector()), strict=True)), evaluations)


def fit_with_scipy(case: Case) -> Fit:
    """`scipy.optimize.least_squares`, its Jacobian by one batch of rollouts over threads."""
    motions = _Motions(case)
    model = case.nominal.model
    data = [mujoco.MjData(model) for _ in range(THREADS)]
    evaluations = 0

    def residuals(rows: np.ndarray) -> np.ndarray:
        nonlocal evaluations
        evaluations += len(rows)
        models = [own for row in rows for own in [_changed(model, data[0], case, row)] * len(case.logs)]
        states, _ = rollout.rollout(
            models, data, np.tile(motions.states, (len(rows), 1)), np.tile(motions.controls[:, :-1], (len(rows), 1, 1))
        )
        simulated = states[:, :, 1 : 1 + model.nq].reshape(len(rows), *motions.measured.shape)
        return motions.scale * (simulated - motions.measured).reshape(len(rows), -1)

    low, high = np.array([(item.low, item.high) for item in case.start]).T
    here: tuple[np.ndarray, np.ndarray] = (np.empty(0), np.empty(0))

    def one(x: np.ndarray) -> np.ndarray:
        nonlocal here
        here = x.copy(), residuals(x[None])[0]
        return here[1]

    def jacobian(x: np.ndarray) -> np.ndarray:
        r = here[1] if np.array_equal(here[0], x) else one(x)
        step = np.sqrt(np.finfo(float).eps) * np.maximum(1.0, np.abs(x))
        step = np.where(x + step > high, -step, step)
        return (residuals(x + np.diag(step)) - r).T / step

    start = np.array([item.value for item in case.start])
    found = least_squares(one, start, jac=jacobian, bounds=(low, high), x_scale="jac", ftol=1e-4, xtol=1e-8, gtol=1e-15)
    return Fit(dict(zip(case.start.names, map(float, found.x), strict=True)), evaluations)


class _Motions:
    """The logs of a case as MuJoCo's rollout wants them.

    Attributes:
        states: where the motions begin, (E, S).
        controls: one per stamp, which are the steps of the simulation, (E, N + 1, J).
        measured: positions after each step, (E, N, J).
        scale: of the residual, so that its sum of squares is a mean square.
    """

    def __init__(self, case: Case) -> None:
        model = case.nominal.model
        at_rest = np.zeros(1 + model.nq + model.nv)
        self.states = np.tile(at_rest, (len(case.logs), 1))
        self.states[:, 1 : 1 + model.nq] = [log.measured["position"][0] for log in case.logs]
        self.controls = np.stack([log.commanded()["position"] for log in case.logs])
        self.measured = np.stack([log.measured["position"][1:] for log in case.logs])
        assert self.measured.shape[1] == self.controls.shape[1] - 1
        self.scale = 1.0 / np.sqrt(self.measured.size)


def _write(spec: mujoco.MjSpec, item: Parameter, value: float) -> None:
    joint = spec.joint(item.target)
    if item.quantity == "damping":
        joint.damping[0] = value
    else:
        setattr(joint, item.quantity, value)


def _changed(model: mujoco.MjModel, data: mujoco.MjData, case: Case, row: np.ndarray) -> mujoco.MjModel:
    """A copy of the compiled model with other numbers, and what follows from them."""
    changed = copy.copy(model)
    for item, value in zip(case.start, row, strict=True):
        field = getattr(changed, f"dof_{item.quantity}")
        field[changed.jnt_dofadr[changed.joint(item.target).id]] = value
    mujoco.mj_setConst(changed, data)
    return changed

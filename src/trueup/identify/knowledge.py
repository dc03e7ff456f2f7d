"""What is known about the parameters of a fit before new motions are recorded: from a configuration, or from a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.core.config import build
from trueup.core.fit_result import FitResult, FittedParameter
from trueup.core.parameters import Parameter, ParameterSet, split_name
from trueup.errors import ConfigError, DataError, NameMismatch
from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.information import PLANNED, Noise
from trueup.identify.quantities import quantity
from trueup.identify.uncertainty import Z95, model_part, precision_of

# An encoder of a hobby servo resolves 1.5 mrad; half of that, and what a loop adds to it [rad or m].
USUAL_NOISE = 1e-3
# Rounded correlations of which the small ones are left out need not belong to any distribution.
_LEAST_EIGENVALUE = 1e-4


@dataclass(frozen=True, eq=False)
class Knowledge:
    """The parameters of a fit, and how well they are known.

    Attributes:
        parameters: as a fit of one motion called `planned` would have them, at their likeliest values.
        precision: inverse covariance of the model's P free parameters, in z, (P, P).
        noise: signal -> joint -> standard deviation of one sample.
        window_s: restart from the measured state this often [s], as the fit does; None for whole motions.
    """

    parameters: ParameterSet
    precision: Float64[np.ndarray, "P P"]
    noise: Noise
    window_s: float | None = None

    @property
    def std(self) -> Float64[np.ndarray, "P"]:
        """Standard deviations of the model's free parameters, in z."""
        return deviations(self.precision)

    @staticmethod
    def of_config(config: IdentifyConfig | None, nominal: Nominal, *, noise: float = USUAL_NOISE) -> Knowledge:
        """What the priors say, around the model's values.

        Args:
            config: what will be fitted; the default for the robot's controller if None.
            nominal: the model.
            noise: standard deviation of one sample of a position [rad or m]. What other signals and joints have
                follows from their weights: a fit is right to weigh by the inverse of the noise.

        Raises:
            ConfigError: the configuration does not fit the robot; a noise that is not positive.
        """
        resolved = (config or IdentifyConfig()).resolved(nominal)
        parameters = make_parameters(resolved.fit, nominal, (PLANNED,))
        prior = precision_of(model_part(parameters)[0])
        each = dict.fromkeys(nominal.robot.scored_joints, noise)
        return Knowledge(parameters, prior, _by_weight(resolved, each), resolved.data.window_s)

    @staticmethod
    def of_fit(fit: FitResult, nominal: Nominal, *, noise: float | None = None, rate_hz: float = 100.0) -> Knowledge:
        """What a fit has found: its values, intervals and correlations, and its residual as the noise.

        A residual with a memory tells less than its samples seem to: the noise is larger by the root of the number of
        samples that count as one.

        Args:
            fit: of this robot and model.
            nominal: the model as it came.
            noise: as for `of_config`, in place of the fit's residual.
            rate_hz: of the recordings to come [Hz].

        Raises:
            NameMismatch: the fit is of another robot.
            ConfigError: the fit is of another model.
            DataError: the fit does not say what it was made with.
        """
        config = _config_of(fit, nominal)
        parameters = ParameterSet(
            (
                *(parameter_of(item) for item in fit.parameters),
                *make_parameters(_of_recordings(config), nominal, (PLANNED,)),
            )
        )
        if noise is not None:
            each = dict.fromkeys(nominal.robot.scored_joints, noise)
        else:
            each = {
                joint: item.rms * float(np.sqrt(1.0 + item.correlation_s * rate_hz))
                for joint, item in fit.whiteness.items()
            } or dict.fromkeys(nominal.robot.scored_joints, USUAL_NOISE)
            # The residual is not weighted; its size has the joint's weight in it already.
            config = replace(config, joints={})
        return Knowledge(parameters, _precision(fit), _by_weight(config, each), config.data.window_s)


def deviations(precision: Float64[np.ndarray, "P P"]) -> Float64[np.ndarray, "P"]:
    """Standard deviations that belong to an inverse covariance, (P,)."""
    scale = 1.0 / np.sqrt(np.diag(precision))
    inverse = np.linalg.inv(precision * np.outer(scale, scale))
    return np.asarray(scale * np.sqrt(np.diag(inverse)))


def _by_weight(config: IdentifyConfig, position: Mapping[str, float]) -> dict[str, dict[str, float]]:
    weights = {name: weight for name, weight in config.weights.items() if weight}
    joints = {
        joint: std / config.joints.get(joint, 1.0) for joint, std in position.items() if config.joints.get(joint, 1.0)
    }
    return {
        name: {joint: std * weights["position"] / weight for joint, std in joints.items()}
        for name, weight in weights.items()
    }


def _config_of(fit: FitResult, nominal: Nominal) -> IdentifyConfig:
    """What the fit was made with, if it was made with this robot and model."""
    robot = nominal.robot
    try:
        made: Mapping[str, Any] = fit.provenance["config"]
        name, model = made["robot"]["name"], made["model"]
        joints = tuple(joint["name"] for joint in made["robot"]["joints"])
        config = build(IdentifyConfig, made["identify"], "fit.json: identify")
    except (KeyError, TypeError) as error:
        raise DataError("the fit does not say what it was made with", got=repr(error)) from error
    if (name, joints) != (robot.name, robot.joint_names):
        raise NameMismatch(
            "the fit is of another robot",
            left=(name, *joints),
            right=(robot.name, *robot.joint_names),
            left_name="fit of",
            right_name="robot",
        )
    if model != nominal.path.name:
        raise ConfigError(
            "the fit is of another model",
            got=model,
            expected=nominal.path.name,
            hint="Give the robot and the model that the fit began with, not the fitted ones.",
        )
    return config


def _of_recordings(config: IdentifyConfig) -> dict[str, Any]:
    return {name: choice for name, choice in config.fit.items() if quantity(name).of == "motion"}


def parameter_of(item: FittedParameter) -> Parameter:
    """What was fitted, as a parameter that starts at its fitted value, without a prior."""
    value = item.value if item.frozen else min(max(item.value, item.low), item.high)
    return Parameter(
        name=item.name,
        value=value,
        unit=item.unit,
        low=item.low,
        high=item.high,
        transform=item.transform,
        scale=quantity(split_name(item.name)[0]).search.scale,
        frozen=item.frozen,
        nominal=item.nominal,
    )


def _precision(fit: FitResult) -> Float64[np.ndarray, "P P"]:
    """Inverse covariance of the fitted parameters in z, from intervals and correlations."""
    std = np.array([_std(item) for item in fit.free])
    names = [item.name for item in fit.free]
    rows = [[1.0 if one == other else fit.correlation.get(one, {}).get(other, 0.0) for other in names] for one in names]
    values, vectors = np.linalg.eigh(np.array(rows))
    correlation = (vectors * np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T
    scale = np.sqrt(np.diag(correlation)) / std
    return np.asarray(np.linalg.inv(correlation) * np.outer(scale, scale))


def _std(item: FittedParameter) -> float:
    """Standard deviation in z; of an interval that ends on a bound, from its other half."""
    parameter = parameter_of(item)
    low, high = (
        parameter.to_z(max(end, 1e-300)) if item.transform == "log" else parameter.to_z(end) for end in item.interval
    )
    z = parameter.to_z(parameter.value)
    return max(high - z, z - low, 1e-9) / Z95

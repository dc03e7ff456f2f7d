"""Functions of time with two derivatives: chirp, multisine, Gaussian random field, Chebyshev polynomials.

The last two are the input functions of GapONet, section A.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError

Samples = Float64[np.ndarray, "T"]


@runtime_checkable
class Function(Protocol):
    """A function of time."""

    def __call__(self, time_s: Samples) -> tuple[Samples, Samples, Samples]:
        """Value, first and second derivative at T times, each (T,)."""
        ...


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (value > 0 and np.isfinite(value)):
            raise ConfigError(f"{name} must be positive", got=value)


@dataclass(frozen=True)
class Chirp:
    """sin(phase + 2 pi (f0 t + (f1 - f0) t^2 / (2 T))): the frequency goes from f0 to f1 in T.

    Raises:
        ConfigError: a frequency or duration that is not positive.
    """

    first_hz: float
    last_hz: float
    duration_s: float
    phase_rad: float = 0.0

    def __post_init__(self) -> None:
        """Refuse negative frequencies."""
        _positive(first_hz=self.first_hz, last_hz=self.last_hz, duration_s=self.duration_s)

    def __call__(self, time_s: Samples) -> tuple[Samples, Samples, Samples]:
        """Value and derivatives."""
        slope = 2 * np.pi * (self.last_hz - self.first_hz) / self.duration_s
        rate = 2 * np.pi * self.first_hz + slope * time_s
        phase = self.phase_rad + 2 * np.pi * self.first_hz * time_s + slope * time_s**2 / 2
        sine, cosine = np.sin(phase), np.cos(phase)
        return sine, rate * cosine, slope * cosine - rate**2 * sine


@dataclass(frozen=True, eq=False)
class FourierSum:
    """The sum over k of a_k cos(w_k t) + b_k sin(w_k t).

    Attributes:
        omega: angular frequencies, (K,) [rad/s].
        cosine: a, (K,).
        sine: b, (K,).
    """

    omega: Float64[np.ndarray, "K"]
    cosine: Float64[np.ndarray, "K"]
    sine: Float64[np.ndarray, "K"]

    def __call__(self, time_s: Samples) -> tuple[Samples, Samples, Samples]:
        """Value and derivatives."""
        angle = np.outer(time_s, self.omega)
        c, s = np.cos(angle), np.sin(angle)
        value = c @ self.cosine + s @ self.sine
        first = c @ (self.omega * self.sine) - s @ (self.omega * self.cosine)
        second = -(c @ (self.omega**2 * self.cosine) + s @ (self.omega**2 * self.sine))
        return value, first, second


def multisine(rng: np.random.Generator, *, base_hz: float, highest_hz: float) -> FourierSum:
    """Harmonics of `base_hz` up to `highest_hz`, equally strong, with random phases; variance 1.

    Raises:
        ConfigError: a frequency that is not positive, or no harmonic in the range.
    """
    _positive(base_hz=base_hz, highest_hz=highest_hz)
    count = int(highest_hz / base_hz + 1e-9)
    if count < 1:
        raise ConfigError("a multisine needs a harmonic", got=f"{highest_hz} Hz", expected=f"at least {base_hz} Hz")
    phase = rng.uniform(0, 2 * np.pi, count)
    strength = np.sqrt(2 / count)
    omega = 2 * np.pi * base_hz * np.arange(1, count + 1)
    return FourierSum(omega, strength * np.cos(phase), strength * np.sin(phase))


def random_field(rng: np.random.Generator, *, length_s: float, duration_s: float) -> FourierSum:
    """A draw from a Gaussian random field of variance 1 and covariance exp(-(t - s)^2 / (2 length^2)).

    On a period of the duration and eight lengths, the covariance repeated with that period has a Fourier series with
    coefficients S_k = sqrt(2 pi) length / period exp(-(w_k length)^2 / 2), doubled for k > 0. Independent Gaussian
    coefficients of these variances give exactly this field; what the repetition and the end of the series change is
    below 1e-8.

    Raises:
        ConfigError: a length or duration that is not positive.
    """
    _positive(length_s=length_s, duration_s=duration_s)
    period = duration_s + 8 * length_s
    count = int(np.ceil(6.5 / length_s * period / (2 * np.pi)))
    omega = 2 * np.pi / period * np.arange(count + 1)
    variance = np.sqrt(2 * np.pi) * length_s / period * np.exp(-((omega * length_s) ** 2) / 2)
    variance[1:] *= 2
    cosine, sine = rng.standard_normal((2, count + 1)) * np.sqrt(variance)
    return FourierSum(omega, cosine, sine)


@dataclass(frozen=True, eq=False)
class Chebyshev:
    """The sum over k of c_k T_k(2 t / duration - 1).

    Attributes:
        coefficients: c, (K,).
        duration_s: where the argument reaches 1 [s].

    Raises:
        ConfigError: a duration that is not positive.
    """

    coefficients: Float64[np.ndarray, "K"]
    duration_s: float

    def __post_init__(self) -> None:
        """Refuse an empty interval."""
        _positive(duration_s=self.duration_s)

    def __call__(self, time_s: Samples) -> tuple[Samples, Samples, Samples]:
        """Value and derivatives."""
        from numpy.polynomial import chebyshev

        scale = 2 / self.duration_s
        where = scale * time_s - 1
        first, second = (chebyshev.chebder(self.coefficients, order) for order in (1, 2))
        return (
            chebyshev.chebval(where, self.coefficients),
            scale * chebyshev.chebval(where, first),
            scale**2 * chebyshev.chebval(where, second),
        )


def random_chebyshev(rng: np.random.Generator, *, degree: int, duration_s: float) -> Chebyshev:
    """Coefficients of variance 1 for T_1 to T_degree; T_0 is left out, since it moves nothing.

    Raises:
        ConfigError: a degree below 1, or a duration that is not positive.
    """
    if degree < 1:
        raise ConfigError("the degree must be at least 1", got=degree)
    return Chebyshev(np.concatenate([[0.0], rng.standard_normal(degree)]), duration_s)


def taper(time_s: Samples, duration_s: float, ramp_s: float) -> tuple[Samples, Samples, Samples]:
    """A window that rises from 0 to 1, stays, and falls to 0, with its derivatives.

    The ramps are 6 x^5 - 15 x^4 + 10 x^3: value, velocity and acceleration vanish at the ends.

    Args:
        time_s: times in [0, duration], (T,).
        duration_s: where it is 0 again [s].
        ramp_s: length of each ramp [s], above 0, at most half the duration.
    """
    near_end = np.minimum(time_s, duration_s - time_s)
    x = np.clip(near_end / ramp_s, 0, 1)
    side = np.where(time_s <= duration_s / 2, 1.0, -1.0) / ramp_s
    value = x**3 * (10 + x * (6 * x - 15))
    first = 30 * x**2 * (1 - x) ** 2 * side
    second = 60 * x * (1 - x) * (1 - 2 * x) / ramp_s**2
    return value, first, second

"""What an identification left open: models drawn from it, all numbers together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from trueup.core.atomic import read_json
from trueup.core.fit_result import FitResult
from trueup.core.npz import read_arrays
from trueup.core.parameters import split_name
from trueup.errors import ConfigError, DataError, NameMismatch
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.export import MODEL_FILE, SAMPLES_FILE
from trueup.identify.inertial import COMPONENTS, Inertial
from trueup.identify.quantities import QUANTITIES, Quantity, quantity


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws all numbers of an identification together, with their correlations.

    Models are drawn around the one that was identified. They are the same ones whether the candidate is of the model
    as it came or of the fitted one: factors and differences, which the fitted model has already, are taken out of it
    before they are drawn.

    Attributes:
        folder: of the identification.
        samples: parameter -> its values, of the same draws, (S,).
        fitted: parameter -> its value in the fitted model.
    """

    folder: Path
    samples: Mapping[str, Float64[np.ndarray, "S"]]
    fitted: Mapping[str, float]
    _before: dict[Nominal, dict[str, Inertial]] = field(default_factory=dict, init=False, repr=False)

    @staticmethod
    def load(folder: Path, *, force: bool = False) -> Posterior:
        """What is in `fit.json` and `fit.samples.npz`.

        Args:
            folder: where they are.
            force: also those of a fit whose status is not ok.

        Raises:
            ConfigError: the fit is not ok.
            DataError: the samples are not there, or are none.
            NameMismatch: parameters that nobody knows.
        """
        fit = FitResult.from_json(read_json(folder / "fit.json"), str(folder / "fit.json"))
        if fit.status != "ok" and not force:
            said = fit.statements[0] if fit.statements else "see its report"
            raise ConfigError(
                f"{folder}: the identification is {fit.status}: {said}",
                expected="status ok",
                hint="Record what it asks for, or force it if you accept what it says.",
            )
        samples = _read_samples(folder / SAMPLES_FILE, fit)
        return Posterior(folder, samples, {item.name: item.value for item in fit.parameters})

    def check(self, nominal: Nominal) -> None:
        """Look whether it can be drawn around this model.

        Raises:
            NameMismatch: it is of joints and bodies that the model does not have.
            ConfigError: it has factors, and the model is that of another identification.
        """
        for about, target in map(_parts, self.samples):
            known = about.targets(nominal)
            if about.of != "motion" and target and target not in known:
                raise NameMismatch(
                    f"{self.folder} is the identification of another robot: {about.name}[{target}]",
                    left=[target],
                    right=list(known),
                    left_name="it has",
                    right_name="robot has",
                )
        self._undone(nominal)

    def __call__(self, candidate: Candidate, rng: np.random.Generator) -> None:
        """Change a candidate to another one of those that the data allow."""
        candidate.inertials |= self._undone(candidate.nominal)
        row = int(rng.integers(len(next(iter(self.samples.values())))))
        for name, values in self.samples.items():
            about, target = _parts(name)
            for place in about.places(candidate.nominal, target):
                about.write(candidate, place, float(values[row]))

    def _undone(self, nominal: Nominal) -> dict[str, Inertial]:
        """Body -> its inertia before factors and differences were fitted, where the model has them already."""
        if nominal not in self._before:
            self._before[nominal] = self._undo(nominal) if self._already_in(nominal) else {}
        return self._before[nominal]

    def _already_in(self, nominal: Nominal) -> bool:
        relative = [name for name in self.samples if _parts(name)[0].relative]
        if not relative:
            return False
        own = self.folder / MODEL_FILE
        if own.is_file() and own.read_bytes() == nominal.path.read_bytes():
            return True
        if nominal.path.name == MODEL_FILE:
            raise ConfigError(
                f"{self.folder} has changes of the model that it identified, as {relative[0]}, and {nominal.path} is "
                "another identified one",
                expected=f"the model as it came, or {own} as it was written",
            )
        return False

    def _undo(self, nominal: Nominal) -> dict[str, Inertial]:
        values: dict[str, dict[str, float]] = {}
        payload: dict[str, float] = {}
        for name in self.samples:
            about, target = _parts(name)
            if about.relative and about.of == "body":
                for body in about.places(nominal, target):
                    values.setdefault(body, {})[about.name.removeprefix("inertia_")] = self.fitted[name]
            elif about.relative:
                payload[about.name.removeprefix("payload_")] = self.fitted[name]
        found: dict[str, Inertial] = {}
        if payload and not nominal.hangs_payloads:
            body, _ = nominal.payload_place
            found[body] = nominal.inertial(body).minus(nominal.carried(payload))
        for body, own in values.items():
            theta = {name: own[name] for name in COMPONENTS if name in own}
            before = (found.get(body) or nominal.inertial(body)).undeformed(theta)
            found[body] = replace(before, inertia=before.inertia / own.get("scale", 1.0))
        return found


def _parts(name: str) -> tuple[Quantity, str]:
    """What a parameter's name is about, and of which joint or body."""
    about, target = split_name(name)
    return quantity(about), target


def _read_samples(path: Path, fit: FitResult) -> dict[str, Float64[np.ndarray, "S"]]:
    if not path.is_file():
        raise DataError(f"{path} is not there", hint="Run trueup identify again; it writes them beside fit.json.")
    try:
        samples = {name: np.asarray(values, np.float64) for name, values in read_arrays(path).items()}
    except (DataError, ValueError) as error:
        raise DataError(f"{path} holds no samples", got=error) from error
    strangers = [name for name in samples if split_name(name)[0] not in QUANTITIES]
    if strangers:
        raise NameMismatch(f"{path}: unknown parameters", left=strangers, right=sorted(QUANTITIES))
    if any(values.ndim != 1 or not np.isfinite(values).all() for values in samples.values()):
        raise DataError(f"{path}: samples that are not finite numbers")
    for item in fit.parameters:
        drawn = samples.get(item.name)
        if drawn is not None and not (
            drawn.min(initial=item.low) >= item.low and drawn.max(initial=item.high) <= item.high
        ):
            raise DataError(
                f"{path}: samples of {item.name} outside its bounds",
                got=f"{drawn.min():g} to {drawn.max():g}",
                expected=f"{item.low:g} to {item.high:g}, as fit.json says",
            )
    if len({len(values) for values in samples.values()}) > 1:
        raise DataError(f"{path}: parameters with different numbers of samples")
    # What belongs to single recordings is no part of a model.
    samples = {name: values for name, values in samples.items() if _parts(name)[0].of != "motion"}
    if not samples or not len(next(iter(samples.values()))):
        raise ConfigError(f"{path} has no samples to draw from")
    return samples

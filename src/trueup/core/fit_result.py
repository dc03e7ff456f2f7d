"""The result of an identification: `fit.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from trueup.core.atomic import read_json, write_json
from trueup.core.config import read_versioned
from trueup.core.results import Estimate

FIT_SCHEMA = "trueup.fit/1"
# Beside a result, what it was made from: the robot as it came, which finds its model, and the configuration. Not
# robot.yaml and fit.yaml: people call theirs so, and may keep them in the folder of results.
STOCK_ROBOT, FIT_CONFIG = "robot.stock.yaml", "fit.config.yaml"

# From good to bad; the status of a fit is the worst that applies.
FitStatus = Literal["ok", "unexplained", "not-identifiable", "at-bound", "signal-worse", "not-converged", "no-better"]
Identified = Literal["yes", "effective", "weakly", "no"]
IDENTIFIED: tuple[Identified, ...] = get_args(Identified)


@dataclass(frozen=True)
class FittedParameter:
    """One number after a fit.

    Attributes:
        name: `QUANTITY[TARGET]`.
        value: fitted value.
        unit: of all numbers here.
        nominal: what the model said before; None if it has no such number.
        start: where the fit started.
        low: lower bound.
        high: upper bound.
        interval: 95 % interval; as wide as the prior where the data say nothing.
        at_bound: `low` or `high` if the fit ended on a bound, else empty: the interval means little then.
        identified: whether the data determine it: `yes`, `effective` (they do in this model, which lacks something, so
            that the robot's own number may be another), `weakly` (its interval is wide, or shared with others), `no`
            (what stands here is the prior).
        prior_share: variance after the fit over variance of the prior, 0 to 1; None without a prior.
        sentence: the same in words, with what to record next.
        cause: part of the gap that it belongs to: delay, gains, friction, gravity, inertia.
        transform: `log` or `linear`; on which scale the interval is symmetric.
        frozen: it was not fitted.
        label: what its quantity is, in words.
        absent: it ended on its lower bound, where the robot has next to none of it.
    """

    name: str
    value: float
    unit: str
    nominal: float | None
    start: float
    low: float
    high: float
    interval: tuple[float, float]
    at_bound: Literal["", "low", "high"]
    identified: Identified
    prior_share: float | None
    sentence: str
    cause: str
    transform: Literal["linear", "log"]
    frozen: bool = False
    label: str = ""
    absent: bool = False


@dataclass(frozen=True)
class Direction:
    """A combination of parameters that the data leave open.

    Attributes:
        gain: information of the data over that of the prior along it; below 1 the data say less than the prior.
        weights: parameter -> share, for the parameters that make it up.
    """

    gain: float
    weights: Mapping[str, float]


@dataclass(frozen=True)
class Whiteness:
    """What is left of one joint after the fit.

    Attributes:
        rms: of the residual [unit of the signal].
        correlation_s: time over which the residual is correlated with itself [s]; noise alone has none.
        white: whether it looks like noise: nothing is left that a model could explain.
        sentence: the same in words.
        noise: of the measurement, as the residual's third differences show it [unit of the signal]; None in older
            files.
    """

    rms: float
    correlation_s: float
    white: bool
    sentence: str
    noise: float | None = None


@dataclass(frozen=True)
class Suspect:
    """What a model may lack: a cause that no fitted number expresses, and what it would explain.

    Attributes:
        name: of the cause: `late-feedback`, `integral`, `backlash`, `elastic-joint`, `load-friction`, `warming`,
            `speed-limit`, `payload`, `mirrored` or `mirrored-measurement`.
        joints: whose residual it would explain.
        sizes: one per joint, or a single one [`unit`].
        unit: of the sizes.
        train: share of what is left of these joints, beyond the noise of the measurement, on the fitted motions.
        val: likewise on motions that were not fitted; None without.
        gain: what it explains there in independent observations of the residual.
        sentence: the same in words.
    """

    name: str
    joints: tuple[str, ...]
    sizes: tuple[float, ...]
    unit: str
    train: float
    val: float | None
    gain: float
    sentence: str


@dataclass(frozen=True)
class ModelRow:
    """One model that was tried: which numbers it has, and how well it does on motions it was and was not fitted to.

    Attributes:
        name: e.g. `viscous+coulomb+load`.
        quantities: what was fitted.
        parameters: how many numbers.
        seconds: how long its fit took.
        splits: split -> error, with interval.
        per_joint: split -> joint -> error.
        chosen: whether it is the one that is reported.
    """

    name: str
    quantities: tuple[str, ...]
    parameters: int
    seconds: float
    splits: Mapping[str, Estimate]
    per_joint: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    chosen: bool = False


@dataclass(frozen=True)
class FitResult:
    """What an identification found, and how sure that is.

    Attributes:
        status: the worst of what applies: `ok`; `unexplained` (more is left than the noise of the measurement, so
            numbers may make up for what the model lacks); `not-identifiable` (the data do not determine a parameter
            that
            was asked for, or none at all); `at-bound` (a parameter ended on a bound); `signal-worse` (a logged signal
            is simulated worse than before); `not-converged`; `no-better` (on val, or on train without one, the fitted
            model is no better than the nominal one, or than the command taken as the motion).
        statements: what a user must know before trusting the numbers, most important first.
        solver: name, why it was chosen, why it stopped, iterations, evaluations, seconds, settings; `short_of_time`:
            models whose search a time limit has ended or kept from beginning, if any; of several starts `starts`,
            what came of them, and `agreement`, the same in a word.
        parameters: all parameters, also the frozen ones.
        correlation: parameter -> parameter -> correlation after the fit, of the free ones; pairs above 0.3 only.
        directions: combinations that the data leave open, the worst first.
        whiteness: joint -> what is left.
        models: the models that were tried, if more than one.
        errors: run (`nominal`, `fitted`, and `command` where a position is commanded) -> split -> error of the
            position, with interval.
        signals: logged signal -> joint -> root mean square error of the nominal and of the fitted model, on val, or on
            train without one [unit of the signal].
        suspects: what the model may lack, the most important first.
        data: what it was fitted to: episodes, pieces, seconds, windows, what was left out and why.
        provenance: versions, git hash, seed, data hash, configuration.
    """

    status: FitStatus
    statements: tuple[str, ...]
    solver: Mapping[str, Any]
    parameters: tuple[FittedParameter, ...]
    correlation: Mapping[str, Mapping[str, float]]
    directions: tuple[Direction, ...]
    whiteness: Mapping[str, Whiteness]
    models: tuple[ModelRow, ...] = ()
    errors: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    signals: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    data: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    suspects: tuple[Suspect, ...] = ()

    def __getitem__(self, name: str) -> FittedParameter:
        """The parameter of that name.

        Raises:
            KeyError: there is none.
        """
        return {parameter.name: parameter for parameter in self.parameters}[name]

    @property
    def short_of_time(self) -> bool:
        """Whether a time limit decided about a search: without it, another fit may come of it."""
        return self.solver.get("stop") == "time" or bool(self.solver.get("short_of_time"))

    @property
    def ended_by_time(self) -> bool:
        """Whether it is `not-converged` only since a time limit ended the search of the model that was chosen.

        Not so where only others were kept from beginning, nor where its starts disagree.
        """
        short = self.solver.get("stop") == "time" and self.solver.get("agreement") != "local-minima"
        return short and self.status == "not-converged"

    @property
    def free(self) -> tuple[FittedParameter, ...]:
        """Those that were fitted."""
        return tuple(item for item in self.parameters if not item.frozen)

    @property
    def values(self) -> dict[str, float]:
        """Parameter name -> value."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    def to_json(self) -> dict[str, Any]:
        """The content of fit.json."""
        return {
            "schema": FIT_SCHEMA,
            "status": self.status,
            "statements": list(self.statements),
            "solver": dict(self.solver),
            "errors": {
                run: {split: error.to_json() for split, error in splits.items()} for run, splits in self.errors.items()
            },
            "parameters": [{**asdict(item), "interval": list(item.interval)} for item in self.parameters],
            "correlation": {name: dict(row) for name, row in self.correlation.items()},
            "directions": [{"gain": item.gain, "weights": dict(item.weights)} for item in self.directions],
            "whiteness": {joint: asdict(item) for joint, item in self.whiteness.items()},
            "models": [
                {
                    **asdict(row),
                    "quantities": list(row.quantities),
                    "splits": {split: error.to_json() for split, error in row.splits.items()},
                }
                for row in self.models
            ],
            "signals": {
                signal: {joint: list(pair) for joint, pair in own.items()} for signal, own in self.signals.items()
            },
            "suspects": [
                {**asdict(item), "joints": list(item.joints), "sizes": list(item.sizes)} for item in self.suspects
            ],
            "data": dict(self.data),
            "provenance": dict(self.provenance),
        }

    @staticmethod
    def from_json(data: Any, where: str = "fit.json") -> FitResult:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: not a fit, or of another version.
            DataError: a fit, but broken.
        """
        return read_versioned(FitResult._read, data, where, schema=FIT_SCHEMA, what="fit")

    @staticmethod
    def _read(data: Mapping[str, Any]) -> FitResult:
        return FitResult(
            status=data["status"],
            statements=tuple(data["statements"]),
            solver=data["solver"],
            parameters=tuple(
                FittedParameter(**{**item, "interval": tuple(item["interval"])}) for item in data["parameters"]
            ),
            correlation=data["correlation"],
            directions=tuple(Direction(item["gain"], item["weights"]) for item in data["directions"]),
            whiteness={joint: Whiteness(**item) for joint, item in data["whiteness"].items()},
            models=tuple(
                ModelRow(
                    **{
                        **row,
                        "quantities": tuple(row["quantities"]),
                        "splits": {split: Estimate.from_json(error) for split, error in row["splits"].items()},
                    }
                )
                for row in data["models"]
            ),
            errors={
                run: {split: Estimate.from_json(error) for split, error in splits.items()}
                for run, splits in data["errors"].items()
            },
            signals={
                signal: {joint: (float(before), float(after)) for joint, (before, after) in own.items()}
                for signal, own in data.get("signals", {}).items()  # of files that were written before there were any
            },
            suspects=tuple(
                Suspect(**{**item, "joints": tuple(item["joints"]), "sizes": tuple(item["sizes"])})
                for item in data.get("suspects", ())
            ),
            data=data["data"],
            provenance=data["provenance"],
        )

    def save(self, path: Path) -> None:
        """Write fit.json."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> FitResult:
        """Read fit.json.

        Raises:
            FormatError: not a fit, or of another version.
            DataError: missing or broken.
        """
        return FitResult.from_json(read_json(path), str(path))

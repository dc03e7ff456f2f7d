"""Made-up cells of the foreign benchmark, for the tests of what is read from them and of their page."""

from trueup.core.fit_result import FitResult, FittedParameter, Whiteness

TRUTH = {
    "parameters": {
        "kp[a]": 50.0,
        "kv[a]": 1.6,
        "damping[a]": 0.6,
        "delay_s[a]": 0.01,
        "torque_offset[a]": 0.0,
        "mass[hand]": 0.5,
        "com_x[hand]": 0.01,
        "inertia_scale[hand]": 1.0,
    },
    "sums": {"kv+damping[a]": 2.2},
    "limits": {"a": None, "b": 9.0},
    "cause": {},
}
PAYLOAD = {"kind": "payload", "joints": ["a", "b"], "body": "hand", "mass_kg": 1.2}


def parameter(name, value, interval, *, identified="yes", frozen=False, transform="log"):
    low, high = map(float, interval)
    sentence = "determined by the data"
    words = {"unit": "1", "nominal": 60.0, "start": 60.0, "at_bound": "", "prior_share": 0.0, "cause": "gains"}
    return FittedParameter(
        name, value, interval=(low, high), low=0.1 * low, high=10 * high, identified=identified, sentence=sentence,
        transform=transform, frozen=frozen, **words,
    )  # fmt: skip


def fit_result(*parameters, status="ok", statements=()):
    return FitResult(
        status=status,
        statements=tuple(statements),
        solver={"name": "gauss-newton", "stop": "converged"},
        parameters=parameters,
        correlation={},
        directions=(),
        whiteness={"a": Whiteness(3.1e-4, 0.0, white=True, sentence="noise", noise=3e-4)},
        data={"seconds": 40.0, "timestep_s": 5e-4, "command": "held", "window_s": None},
    )


def number(name, ends, truth, *, identified="yes", frozen=False, transform="log"):
    low, value, high = ends
    return {
        "name": name, "value": value, "low": low, "high": high, "truth": truth, "nominal": 60.0,
        "identified": identified, "frozen": frozen, "at_bound": "", "transform": transform,
    }  # fmt: skip


def cell(group="A", **changed):
    """A cell in which all is well."""
    plain = {
        "case": "demo_arm" if group == "A" else "demo_arm_backlash",
        "group": group,
        "robot": "demo_arm",
        "seed": 0,
        "drive": "position",
        "commands": "held",
        "engine": "dart",
        "joints": ["a", "b"],
        "cause": {},
        "noise": 3e-4,
        "status": "ok",
        "code": 0,
        "seconds": 100.0,
        "said": "",
        "statements": [],
        "findings": [],
        "steps": {},
        "numbers": [number("kp[a]", (45, 50, 55), 51), number("kp[b]", (20, 50, 90), 51, identified="no")],
        "sums": [{"name": "kv+damping[a]", "value": 2.0, "low": 1.9, "high": 2.3, "truth": 2.2}],
        "left": {"a": {"rms": 3.1e-4, "noise": 3e-4}},
        "fit": {"model": "base", "stop": "converged", "short_of_time": False, "command": "held"},
        "made": {"machine": "a machine", "git": "0123456789", "created": "2026-11-25T10:00:00+00:00"},
    }
    return {**plain, **changed}

"""What commands that train policies have in common: options, and the configuration that they make."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.policy.config import PolicyConfig

Config = Annotated[str, typer.Option("--config", help="laptop, paper, or a YAML file; see docs/policies.md.")]
Algorithm = Annotated[
    str | None,
    typer.Option("--algorithm", help="ddpg, sac, td3 or tqc; the configuration's if not given, of paper tqc."),
]
Randomize = Annotated[
    str | None,
    typer.Option(
        "--randomize", help="none, thesis, or the folder of an identification; the configuration's if not given."
    ),
]
Steps = Annotated[int | None, typer.Option("--steps", min=1, help="Control steps of all arms together.")]
Start = Annotated[
    Path | None,
    typer.Option("--start", help="Folder of a policy to begin with, trained in another simulator, say."),
]
Device = Annotated[str, typer.Option("--device", help="Where networks learn: cpu or cuda.")]
Force = Annotated[bool, typer.Option("--force", help="Randomize by an identification whose status is not ok, too.")]


def configured(
    config: str, algorithm: str | None, randomize: str | None, steps: int | None, start: Path | None = None
) -> PolicyConfig:
    """The configuration that options ask for.

    Raises:
        ConfigError: it is none.
    """
    from trueup.core.config import build, read_yaml
    from trueup.policy.config import ALGORITHMS, LAPTOP, PAPER, PAPER_ARMS, PolicyConfig, laptop
    from trueup.policy.randomization import THESIS, RandomizationConfig

    if algorithm is not None and algorithm not in ALGORITHMS:
        raise ConfigError("there is no such algorithm", got=algorithm, available=ALGORITHMS)
    given = {} if algorithm is None else {"algorithm": algorithm}
    if config == "laptop":
        chosen = laptop(algorithm or LAPTOP.algorithm)
    elif config == "paper":
        chosen = build(PolicyConfig, given, config)
        chosen = replace(chosen, learner=PAPER[chosen.algorithm], arms=PAPER_ARMS)
    else:
        chosen = build(PolicyConfig, {**read_yaml(Path(config)), **given}, config)
    if randomize is not None:
        named = {"none": RandomizationConfig(), "thesis": THESIS}
        chosen = replace(chosen, randomization=named.get(randomize) or RandomizationConfig(posterior=randomize))
    if start is not None:
        chosen = replace(chosen, start=str(start))
    return chosen if steps is None else replace(chosen, steps=steps)

"""Trained networks and policies that come with the package.

    import trueup.zoo

    model = trueup.zoo.load("panda-realeasy-rt")
    stream = model.stream(rate_hz=100, joints=model.card.joints)

Where a command takes the folder of a model, it takes `zoo:panda-realeasy-rt`, too; where it takes that of a policy,
`zoo:panda-reach`.

Each is a model folder with a card for people, `CARD.md`, beside it: what it was trained on, what it is good for and
what not. `python -m benchmarks.zoo` makes the networks again, `python -m benchmarks.policy_zoo` the policies.
"""

from __future__ import annotations

from pathlib import Path

from trueup.augment.trained import Trained
from trueup.core.model_card import CARD_NAME
from trueup.core.policy_card import POLICY_CARD
from trueup.errors import MissingSignal

_HERE = Path(__file__).parent
_PREFIX = "zoo:"


def names() -> tuple[str, ...]:
    """The networks that are there."""
    return tuple(sorted(path.parent.name for path in _HERE.glob(f"*/{CARD_NAME}")))


def policies() -> tuple[str, ...]:
    """The policies that are there."""
    return tuple(sorted(path.parent.name for path in _HERE.glob(f"*/{POLICY_CARD}")))


def folder(name: str) -> Path:
    """The folder of a network or policy.

    Raises:
        MissingSignal: there is none of this name.
    """
    if name not in (there := (*names(), *policies())):
        raise MissingSignal(f"the zoo has no {name!r}", available=there)
    return _HERE / name


def folder_of(text: str | Path) -> Path:
    """The folder that a user means: `zoo:NAME` is one of the zoo, all else is a path.

    Raises:
        MissingSignal: the zoo has nothing of this name.
    """
    name = str(text)
    return folder(name.removeprefix(_PREFIX)) if name.startswith(_PREFIX) else Path(text)


def load(name: str) -> Trained:
    """A network, ready to correct motions or to run in a control loop.

    Raises:
        MissingSignal: there is none of this name.
    """
    return Trained.load(folder(name))

"""Networks, one file each. A file needs torch and is loaded when it is asked for; this table is not its work.

A file offers `KINDS`, the `kind` of a configuration -> class, and `methods()`, what `--method` chooses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from trueup.errors import ConfigError, needing

if TYPE_CHECKING:
    from trueup.augment.config import Method, NetworkConfig
    from trueup.augment.networks.base import Network

# Method -> the file that it stands in.
_FILES: Mapping[str, str] = {
    "realeasy": "recurrent",
    "realeasy-rt": "recurrent",
    "gru": "recurrent",
    "mlp": "perceptron",
    "linear": "perceptron",
    "transformer": "transformer",
    "sat": "sat",
    "sat-bodies": "sat",
    "moving-average": "moving_average",
    "moving-average-rt": "moving_average",
}
METHODS = tuple(_FILES)
# Of kinds that no method of `augment` has.
_FURTHER = ("operator",)


def method(name: str) -> Method:
    """The method of this name.

    Raises:
        ConfigError: there is none.
        MissingDependency: torch is not installed.
    """
    if name not in METHODS:
        raise ConfigError("there is no such method", got=name, available=METHODS)
    found: Method = next(item for item in _file(_FILES[name]).methods() if item.config.method == name)
    return found


def network_class(kind: str) -> type[Network]:
    """The class of a kind of network; errors as of `method`."""
    kinds = {
        name: cls for file in dict.fromkeys((*_FILES.values(), *_FURTHER)) for name, cls in _file(file).KINDS.items()
    }
    if kind not in kinds:
        raise ConfigError("network: kind is not a choice", got=repr(kind), available=kinds)
    found: type[Network] = kinds[kind]
    return found


def build_network(config: NetworkConfig, *, inputs: int, base: Sequence[int], rate_hz: float = 100.0) -> Network:
    """The network of a configuration, with random weights; the arguments are those of `Network`."""
    return network_class(config.kind)(config, inputs, base, rate_hz)


def _file(name: str) -> Any:
    with needing("training", "learn"):
        return import_module(f"{__name__}.{name}")

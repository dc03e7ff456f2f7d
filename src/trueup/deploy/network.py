"""A model folder, opened: its card, its hashes looked at, its graph in onnxruntime."""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from trueup.core.model_card import CARD_NAME, ONNX_NAME, ModelCard, State
from trueup.deploy.operator_weights import OperatorWeights
from trueup.deploy.operators import check_operators
from trueup.deploy.sat_weights import SatWeights
from trueup.deploy.step_file import StepFile
from trueup.deploy.trial import session_options, tried
from trueup.errors import DataError, needing

_TYPE = "tensor(float)"
# Sizes of a tensor's axes as onnxruntime reports them: numbers, or names (or None) for what may vary.
_Shape = Sequence[int | str | None]


@dataclass(frozen=True, eq=False)
class Network:
    """A trained network, ready to run.

    Attributes:
        folder: where it came from.
        card: what it says of itself.
        session: onnxruntime's session over the graph, on one thread of the CPU.
        step: weights for machine code that takes the same steps, where the folder has them.
    """

    folder: Path
    card: ModelCard
    session: Any
    step: SatWeights | OperatorWeights | None = None

    @staticmethod
    def load(folder: Path | str) -> Network:
        """Open a model folder.

        Raises:
            DataError: a file is missing, truncated or changed, or graph and card do not belong together.
            FormatError: the card is of another version.
            MissingDependency: onnxruntime is not installed.
        """
        folder = Path(folder)
        card = ModelCard.load(folder)
        _check_card(card, folder)
        # The bytes whose hash was taken, not the file again; other files, to which a graph may refer, have no hash, and
        # `session_of` refuses it.
        session = session_of(card.verified(folder, ONNX_NAME), str(folder / ONNX_NAME))
        _check_graph(session, card, folder)
        return Network(folder, card, session, _step_of(folder, card))

    @property
    def stepwise(self) -> bool:
        """Whether it takes one sample at a time only."""
        return _takes_one(self.session)

    def of_joints(self, joints: Sequence[str]) -> Network:
        """The network on a robot with these joints; see `ModelCard.of_joints`."""
        return replace(self, card=self.card.of_joints(joints))

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process goes where it lies, and not the session, which cannot; there it is opened again."""
        return _opened_again, (self.folder.absolute(), self.card)


def _opened_again(folder: Path, card: ModelCard) -> Network:
    """The same network, of the same joints.

    Raises:
        DataError: there is another one by now; and the errors of `Network.load`.
    """
    network = Network.load(folder)
    if network.card.files != card.files:
        raise DataError(
            f"{folder} holds another network than when it was opened before",
            hint="Leave a model folder as it is while processes work with it; train into another one.",
        )
    return replace(network, card=card)


def _step_of(folder: Path, card: ModelCard) -> SatWeights | OperatorWeights | None:
    file = StepFile.load(folder, card)
    if file is None:
        return None
    return OperatorWeights.of_file(file, card) if "branch" in file.arrays else SatWeights.of_file(file, card)


def _check_card(card: ModelCard, folder: Path) -> None:
    """What a card must say to be run, beyond what its own constructor checks."""
    where = folder / CARD_NAME
    if card.states and not card.causal:
        raise DataError(f"{where} is broken: a network that looks into the future has no states", got=_names(card))
    for output in card.outputs:
        known = output.far_correction
        if len(known) != len(output.far_probability) or any(b <= a for a, b in itertools.pairwise(known)):
            raise DataError(f"{where} is broken: the probabilities of {output.name}", got=known, expected="increasing")
    of_joints = (channel for channel in (*card.inputs, *card.outputs) if channel.series != "condition")
    strange = [channel.name for channel in of_joints if channel.joint not in card.joints]
    if strange:
        raise DataError(f"{where} is broken: its robot lacks the joints of {strange}", available=card.joints)


def _check_graph(session: Any, card: ModelCard, folder: Path) -> None:
    """Names, types and shapes of the graph's inputs and outputs are those of the card.

    A graph with states may take one sample at a time.
    """
    states = {state.name: _shape(state) for state in card.states}
    samples = 1 if _takes_one(session) and states else None
    _check_tensors(
        f"{folder / ONNX_NAME}, inputs", session.get_inputs(), {"x": (samples, None, len(card.inputs)), **states}
    )
    _check_tensors(
        f"{folder / ONNX_NAME}, outputs",
        session.get_outputs(),
        {"y": (samples, None, len(card.outputs)), **{f"{name}_out": shape for name, shape in states.items()}},
    )


def _takes_one(session: Any) -> bool:
    return any(tensor.name == "x" and list(tensor.shape[:1]) == [1] for tensor in session.get_inputs())


def _check_tensors(what: str, found: Sequence[Any], expected: Mapping[str, _Shape]) -> None:
    tensors = {tensor.name: tensor for tensor in found}
    if tensors.keys() != expected.keys():
        raise DataError(f"{what} are not those of {CARD_NAME}", got=list(tensors), expected=list(expected))
    for name, shape in expected.items():
        tensor = tensors[name]
        if tensor.type != _TYPE or not _fits(tensor.shape, shape):
            raise DataError(
                f"{what}: {name!r} is not what {CARD_NAME} says",
                got=f"{tensor.type} {list(tensor.shape)}",
                expected=f"{_TYPE} {['any' if size is None else size for size in shape]}",
            )


def _fits(found: _Shape, expected: _Shape) -> bool:
    """Sizes that are None may vary and must not be fixed; the others may be fixed to that number only."""
    return len(found) == len(expected) and all(
        not isinstance(size, int) if wanted is None else not isinstance(size, int) or size == wanted
        for size, wanted in zip(found, expected, strict=True)
    )


def _shape(state: State) -> tuple[int | None, ...]:
    return tuple(None if axis == state.batch_axis else size for axis, size in enumerate(state.shape))


def _names(card: ModelCard) -> list[str]:
    return [state.name for state in card.states]


def session_of(graph: bytes, where: str) -> Any:
    """Onnxruntime's session over a graph, on one thread of the CPU.

    One thread: a network of this size gains nothing from more, and a second thread that wakes up late would delay the
    control loop.

    Raises:
        DataError: it has operators that no network needs, weights in other files, takes too much memory, or cannot be
            run.
        MissingDependency: onnxruntime is not installed.
    """
    with needing("running a network", "run"):
        runtime = importlib.import_module("onnxruntime")
    check_operators(graph, where)
    options = session_options(runtime)
    # The few kB between a small network's nodes come faster from malloc than from onnxruntime's own pool: by a tenth
    # for a step of 21 -> 100 -> 21, and with a tail that is no longer.
    options.enable_cpu_mem_arena = False
    options.log_severity_level = 3  # errors come as exceptions; warnings about the machine are none of the caller's
    try:
        tried(runtime, graph, where)
        return runtime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except DataError:
        raise
    except Exception as error:  # onnxruntime has a class of its own for each of its codes, with no common base
        raise DataError(f"onnxruntime {runtime.__version__} cannot run {where}", got=error) from error

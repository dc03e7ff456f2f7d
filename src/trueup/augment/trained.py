"""A trained correction as others use it: onnxruntime only, no torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from trueup.augment.correction import corrected
from trueup.augment.simulator import ResidualSimulator
from trueup.core.episode import Episode
from trueup.core.model_card import ModelCard
from trueup.core.protocols import Simulator
from trueup.core.timeseries import TimeSeries
from trueup.deploy import Network, Predictor, Stream, StreamSettings


class Trained:
    """A model folder: whole motions corrected, a stream for control loops, and what makes a simulator a corrected one.

    Args:
        network: an opened model folder.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        self._predictor = Predictor(network)

    @staticmethod
    def load(folder: Path | str) -> Trained:
        """Open a model folder; the errors are those of `deploy.Network.load`."""
        return Trained(Network.load(folder))

    @property
    def card(self) -> ModelCard:
        """What the network says of itself."""
        return self._network.card

    def predict(self, episode: Episode, run: str) -> TimeSeries:
        """One run of an episode as the robot would have measured it, on the run's clock.

        Signals that the network does not correct are as they were.

        Raises:
            TrueupError: what `augment.correction.corrected` raises.
        """
        own = self._predictor.of_joints(self.card.blocks_of(episode.run(run)))
        return corrected(episode, run, own.card, own.run)

    def stream(
        self,
        *,
        rate_hz: float,
        joints: Sequence[str],
        units: Mapping[str, str | Sequence[str]] | None = None,
        settings: StreamSettings | None = None,
    ) -> Stream:
        """The stateful step for a control loop; see `deploy.Stream`."""
        return Stream(self._network, rate_hz=rate_hz, joints=joints, units=units, settings=settings)

    def simulator(self, simulator: Simulator, *, warmup: bool = False) -> ResidualSimulator:
        """A simulator whose signals are corrected, and a Simulator again; see `augment.simulator`."""
        return ResidualSimulator(simulator, self._network, warmup=warmup)

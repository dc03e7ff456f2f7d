"""One payload: the simulated body, the balance that was designed on it, and real bodies under the same balance."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from trueup.errors import DataError
from trueup.whole_body.balance import BalanceSettings, Lean, design_balance
from trueup.whole_body.bodies import Arms, SimulatedBody, WholeBody
from trueup.whole_body.driving import Compensator, DrivingSettings, Trajectory, drive


class Trial:
    """Everything that is designed in simulation, with a payload that is known there.

    Args:
        payload_kg: in each hand [kg].
        driving: profile of the base, settling.
        balance: weights of the regulator.
    """

    def __init__(
        self,
        payload_kg: float = 0.0,
        *,
        driving: DrivingSettings | None = None,
        balance: BalanceSettings | None = None,
    ) -> None:
        self.payload_kg = payload_kg
        self.driving = driving or DrivingSettings()
        self._body = SimulatedBody(payload_kg)
        self.balance = design_balance(self._body.model, self._body.home, balance)
        self._lean = Lean(self._body.model)

    @property
    def home(self) -> Arms:
        """The pose in which the arms wait [rad]."""
        return self._body.home

    def simulated(self, targets: Float64[np.ndarray, "T J"], *, compensator: Compensator | None = None) -> Trajectory:
        """What the simulated body does; its base leans as its own arms need it.

        Args:
            targets: of the arms, one every 20 ms [rad].
            compensator: of the simulated arms; plain PD if None, which hangs where arms and payload pull it.

        Raises:
            DataError: it falls.
        """
        done = drive(self._body, self.balance, targets, lean=self._lean, compensator=compensator, settings=self.driving)
        if done.fallen_s is not None:
            raise DataError("the simulated body falls on this motion", got=f"{done.fallen_s:g} s after its start")
        return done

    def real(
        self,
        body: WholeBody,
        targets: Float64[np.ndarray, "T J"],
        simulated: Trajectory,
        *,
        compensator: Compensator | None = None,
        seed: int = 0,
    ) -> Trajectory:
        """What a real body does; its base leans as the simulated one did.

        Args:
            body: with the same payload.
            targets: as in simulation.
            simulated: what the simulated body did on them.
            compensator: of the real arms; plain PD if None.
            seed: of what the body draws.

        Raises:
            DataError: it holds another payload.
        """
        if body.payload_kg != self.payload_kg:
            raise DataError(
                "this body holds another payload", got=f"{body.payload_kg} kg", expected=f"{self.payload_kg} kg"
            )
        return drive(
            body,
            self.balance,
            targets,
            lean=simulated.lean,
            compensator=compensator,
            settings=self.driving,
            seed=seed,
        )

"""A robot's simulator with any payload, from one control step to the next."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from trueup.robots import RobotSpec, Setup
from trueup.sim import MujocoSimulator
from trueup.sim.transitions import Transitions


class Plants:
    """Simulators of one robot, made when a payload first comes up.

    Args:
        robot: its description; its delay acts between commands and simulator.
        model: MJCF or URDF.
        control_s: control step [s].
        threads: of each simulator.
        empty: the hands stay empty, whatever motions carry: what a policy was trained with.

    Raises:
        ConfigError: of `Transitions`, when the first payload comes up.
    """

    def __init__(
        self, robot: RobotSpec, model: Path, control_s: float, *, threads: int = 1, empty: bool = False
    ) -> None:
        self.robot = robot
        self.control_s = control_s
        self._model = model
        self._threads = threads
        self._empty = empty
        self._known: dict[float, Transitions] = {}
        self._smooth: dict[float, Transitions] = {}

    def __call__(self, payload_kg: float) -> Transitions:
        """The simulator with a payload [kg]."""
        carried = self._carried(payload_kg)
        if carried not in self._known:
            setup = Setup(carried)
            simulator = MujocoSimulator.from_robot(self.robot, self._model, setup=setup, threads=self._threads)
            self._known[carried] = Transitions(simulator, self.control_s, self.robot.delay_s)
        return self._known[carried]

    def smooth(self, payload_kg: float) -> Transitions:
        """The same without dry friction, for slopes."""
        carried = self._carried(payload_kg)
        if carried not in self._smooth:
            self._smooth[carried] = self(payload_kg).without_dry_friction()
        return self._smooth[carried]

    def _carried(self, payload_kg: float) -> float:
        return 0.0 if self._empty else self.robot.carried_kg(payload_kg)

    def simulate(
        self, payload: Tensor, state: Tensor, before: Tensor, command: Tensor, gravity: Tensor | None = None
    ) -> Tensor:
        """See `training.Simulate`."""
        out = torch.empty_like(state)
        for value in np.unique(payload.cpu().numpy()).tolist():
            rows = payload[:, 0] == value
            given = (part[rows].detach().cpu().numpy().astype(np.float64) for part in (state, before, command))
            pull = None if gravity is None else gravity[rows].cpu().numpy().astype(np.float64)
            out[rows] = torch.from_numpy(self(value).next(*given, gravity=pull)).to(out)
        return out

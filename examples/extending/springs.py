"""An engine in Python: joints that follow their command as damped springs would, beside MuJoCo."""

import numpy as np

import trueup
from trueup.align import JointMap
from trueup.core.protocols import RolloutRequest, RolloutResult, Simulator
from trueup.dataset import RunWriter
from trueup.sim import ReplaySettings
from trueup.sim import replay as replayed


class Springs:
    """B copies of joints that follow their command: ddq = w^2 (command - q) - 2 damping w dq."""

    timestep_s = 0.002
    command_signals = ("position",)

    def __init__(self, joints: tuple[str, ...], natural_hz: float, damping: float = 1.0) -> None:
        self.joints, self.w, self.damping = joints, 2 * np.pi * natural_hz, damping

    def rollout(self, request: RolloutRequest) -> RolloutResult:
        self.reset(request.position, request.velocity)
        steps = request.command["position"].swapaxes(0, 1)  # (N, B, J)
        said = [self.step({"position": held}) for held in steps]
        first = {"position": request.position, "velocity": request.velocity, "torque": said[0]["torque"]}
        rows = {name: np.stack([first[name], *(one[name] for one in said)], axis=1) for name in first}
        # Row k of the torque acts from k to k + 1.
        torque = np.concatenate([rows["torque"][:, 1:], rows["torque"][:, -1:]], axis=1)
        return RolloutResult(rows["position"], rows["velocity"], torque)

    def reset(self, position: np.ndarray, velocity: np.ndarray) -> None:
        self.q, self.v = position.copy(), velocity.copy()

    def step(self, command: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        pull = self.w**2 * (command["position"] - self.q) - 2 * self.damping * self.w * self.v
        self.v = self.v + self.timestep_s * pull
        self.q = self.q + self.timestep_s * self.v
        return {"position": self.q, "velocity": self.v, "torque": np.full_like(self.q, np.nan)}  # it has none


robot = trueup.load_robot("demo_arm")
data = trueup.Dataset("runs/arm/dataset")
springs = Springs(robot.joint_names, natural_hz=4.0)
assert isinstance(springs, Simulator)
logs = JointMap.from_dict(robot.joint_rules())  # from the log's names and units to the robot's
info = {"engine": "springs", "joint_map": robot.joint_rules(), "joints": list(robot.joint_names)}
episodes = (logs.of_episode(data.episode(name)) for name in data.ids)
with RunWriter(data.path, "springs/4Hz", run_info=info) as writer:
    for name, series in replayed(episodes, lambda: springs, ReplaySettings.of(robot)):
        writer.append(name, series)
found = trueup.gap(data, runs=["mujoco/stock", "springs/4Hz"], split="test", signals=["position"])
for pair in found.gap.paired:
    print(f"{pair.run} against {pair.baseline}: {100 * pair.relative:.0f} %, {pair.verdict}")

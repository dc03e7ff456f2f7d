"""How do I correct a simulator inside a control loop?

The network in the package corrects a simulated Panda; `status` says whether to trust it.

    python examples/correct_in_a_control_loop.py
"""

import numpy as np

import trueup.zoo
from trueup.deploy import Status, run_loop
from trueup.lab import SimulatedRobot
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

robot = load_robot("panda")
home = np.array([0.0, -0.8, 0.0, -2.4, 0.0, 1.6, 0.8])
simulator = MujocoSimulator.from_robot(robot, find_model(robot))
simulated = SimulatedRobot(simulator, position=home, steps_per_control=1)
stream = trueup.zoo.load("panda-realeasy-rt").stream(rate_hz=100.0, joints=simulated.joints)
changed, trusted = [], 0


def step(time_s: float) -> None:
    global trusted
    simulated.write({"position": home + 0.2 * np.sin(time_s)})
    reading = simulated.read()
    answer = stream.step(reading, time_s=time_s)
    trusted += answer.status is Status.OK
    changed.append(np.abs(answer["torque"] - reading["torque"]).max())


# The simulation's own clock: as fast as it goes. On a robot, leave `clock` out.
report = run_loop(step, rate_hz=100.0, duration_s=3.0, clock=simulated)
print(f"{report.cycles} steps, {trusted} of them corrected; torque changed by up to {max(changed):.2f} Nm")
print(f"a step of the network: 99 % within {stream.latency.percentile_us(99.0):.0f} us")

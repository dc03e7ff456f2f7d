"""Small compensations with random weights, in model folders."""

import numpy as np
import torch
from benchmarks import networks

from trueup.augment.networks.operator import OperatorConfig

SMALL = OperatorConfig(hidden=(8, 8), features=3, trunk=(6, 6), sensors=2, predictor=(6,))


def compensation(folder, joints=("a", "b"), *, rate_hz=50.0, reach=0.4, network=SMALL, **options):
    """Of two slow joints if nothing else is said."""
    return networks.compensation(folder, joints, rate_hz=rate_hz, reach=reach, network=network, **options)


def asked(made, state, command, payload_kg):
    """What the network says of a whole motion, by torch: corrected commands, (T, J)."""
    rows = np.concatenate([state, command, np.full((len(state), 1), payload_kg)], axis=1).astype(np.float32)
    with torch.no_grad():
        return made.corrector(torch.from_numpy(rows)[:, None])[:, 0].numpy()

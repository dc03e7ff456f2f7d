"""Environments of Stable-Baselines3 whose parts are alike, and have nothing of their own to be asked for."""

from __future__ import annotations

from typing import Any

from trueup.errors import needing

with needing("training by reinforcement", "rl"):
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices


class SideBySide(VecEnv):
    """What Stable-Baselines3 asks of every environment, for parts that are simulated together."""

    render_mode = None

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The same of every part."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refused: parts side by side have no attributes of their own."""
        raise NotImplementedError(attr_name)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refused likewise."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        """None is."""
        del wrapper_class
        return [False] * len(list(self._get_indices(indices)))

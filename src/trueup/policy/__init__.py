"""Policies: torque-controlled reaching, trained in simulators and run on hardware (ES thesis, chapters 2 and 4)."""

from typing import TYPE_CHECKING, Any

from trueup.errors import needing
from trueup.policy.reach import ReachConfig, Reward

if TYPE_CHECKING:
    from trueup.policy.residual_env import ResidualEnv as ResidualEnv

__all__ = ["ReachConfig", "ResidualEnv", "Reward", "register"]


def register() -> None:
    """Make `gymnasium.make("TrueupPandaReach-v0")` known; once is enough."""
    with needing("policies", "rl"):
        import gymnasium

    if "TrueupPandaReach-v0" not in gymnasium.registry:
        gymnasium.register("TrueupPandaReach-v0", entry_point="trueup.policy.environment:PandaReach")


def __getattr__(name: str) -> Any:
    """Import what needs Gymnasium on first use."""
    if name != "ResidualEnv":
        raise AttributeError(f"module 'trueup.policy' has no attribute {name!r}")
    with needing("environments", "rl"):
        from trueup.policy.residual_env import ResidualEnv
    return ResidualEnv

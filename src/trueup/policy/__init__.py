"""Policies: torque-controlled reaching, trained in simulators and run on hardware (ES thesis, chapters 2 and 4)."""

from trueup.policy.reach import ReachConfig, Reward

__all__ = ["ReachConfig", "Reward", "register"]


def register() -> None:
    """Make `gymnasium.make("TrueupPandaReach-v0")` known; once is enough."""
    from trueup.errors import needing

    with needing("policies", "rl"):
        import gymnasium

    if "TrueupPandaReach-v0" not in gymnasium.registry:
        gymnasium.register("TrueupPandaReach-v0", entry_point="trueup.policy.environment:PandaReach")

"""Solvers over plain vectors: Gauss-Newton, derivative-free ones behind ask and tell, and several starts."""

from trueup.identify.solvers.agreement import Agreement as Agreement
from trueup.identify.solvers.agreement import compare_ends as compare_ends
from trueup.identify.solvers.ask_tell import AskTell as AskTell
from trueup.identify.solvers.ask_tell import Evaluation as Evaluation
from trueup.identify.solvers.ask_tell import SolverResult as SolverResult
from trueup.identify.solvers.ask_tell import Step as Step
from trueup.identify.solvers.ask_tell import Stop as Stop
from trueup.identify.solvers.ask_tell import minimize as minimize
from trueup.identify.solvers.cma_es import CmaEs as CmaEs
from trueup.identify.solvers.cma_es import CmaSettings as CmaSettings
from trueup.identify.solvers.evolution import EvolutionStrategy as EvolutionStrategy
from trueup.identify.solvers.evolution_settings import EvolutionSettings as EvolutionSettings
from trueup.identify.solvers.evolution_settings import Roles as Roles
from trueup.identify.solvers.gauss_newton import GaussNewton as GaussNewton
from trueup.identify.solvers.gauss_newton import GaussNewtonSettings as GaussNewtonSettings
from trueup.identify.solvers.gauss_newton import GaussNewtonState as GaussNewtonState
from trueup.identify.solvers.loss import Loss as Loss
from trueup.identify.solvers.space import Space as Space
from trueup.identify.solvers.starts import draw_starts as draw_starts

__all__ = [
    "Agreement",
    "AskTell",
    "CmaEs",
    "CmaSettings",
    "Evaluation",
    "EvolutionSettings",
    "EvolutionStrategy",
    "GaussNewton",
    "GaussNewtonSettings",
    "GaussNewtonState",
    "Loss",
    "Roles",
    "SolverResult",
    "Space",
    "Step",
    "Stop",
    "compare_ends",
    "draw_starts",
    "minimize",
]

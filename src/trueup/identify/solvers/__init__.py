"""Solvers over plain vectors: Gauss-Newton, derivative-free ones behind ask and tell, and several starts."""

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
from trueup.identify.solvers.multi_start import Agreement as Agreement
from trueup.identify.solvers.multi_start import LocalSolution as LocalSolution
from trueup.identify.solvers.multi_start import MultiStart as MultiStart
from trueup.identify.solvers.multi_start import MultiStartResult as MultiStartResult
from trueup.identify.solvers.multi_start import compare_solutions as compare_solutions
from trueup.identify.solvers.space import Space as Space
from trueup.identify.solvers.starts import draw_starts as draw_starts
from trueup.identify.solvers.starts import screen_starts as screen_starts

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
    "LocalSolution",
    "MultiStart",
    "MultiStartResult",
    "Roles",
    "SolverResult",
    "Space",
    "Step",
    "Stop",
    "compare_solutions",
    "draw_starts",
    "minimize",
    "screen_starts",
]

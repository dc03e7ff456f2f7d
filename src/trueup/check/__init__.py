"""What is wrong with a set-up, before anything is fitted: signs, names, units, zeros, clocks, gravity, control mode."""

from trueup.check.checking import check_motions
from trueup.check.reading import mended

__all__ = ["check_motions", "mended"]

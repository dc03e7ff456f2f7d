"""Friction of a joint beyond viscous and Coulomb friction: one file for each law, and the table of them."""

from trueup.robots.friction.joint_friction import JointFriction as JointFriction
from trueup.robots.friction.law import Law as Law
from trueup.robots.friction.law import Number as Number
from trueup.robots.friction.laws import LAWS as LAWS
from trueup.robots.friction.laws import NUMBERS as NUMBERS

__all__ = ["LAWS", "NUMBERS", "JointFriction", "Law", "Number"]

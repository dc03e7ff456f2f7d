"""Friction of a joint beyond viscous and Coulomb friction: one file for each law, and the table of them."""

from trueup.robots.friction.joint_friction import JointFriction
from trueup.robots.friction.law import Law, Number
from trueup.robots.friction.laws import LAWS, LEAST_WIDTH, MARK, NUMBERS, WIDTH

__all__ = ["LAWS", "LEAST_WIDTH", "MARK", "NUMBERS", "WIDTH", "JointFriction", "Law", "Number"]

"""Weighted least squares on base parameters: joints weigh by their noise, errors may last from row to row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from trueup.identify.regression.base_parameters import BaseStructure, find_base
from trueup.identify.regression.covariance import Covariance, robust_covariance

_ROUNDS = 4  # of weighing joints by their residual
_LEAST_NOISE = 1e-4  # of the largest torque: no joint is trusted more than that against the others
_EXCITED = 1e-5  # share of a column that the others must leave over to count as shown by the motions


class Solution(NamedTuple):
    """The base parameters that a motion shows.

    Attributes:
        structure: what they are made of.
        values: estimates.
        covariance: robust covariance.
        information: X' W X, the inverse covariance if errors were independent.
        condition: condition number of the columns at equal length.
    """

    structure: BaseStructure
    values: Float64[np.ndarray, "K"]
    covariance: Covariance
    information: Float64[np.ndarray, "K K"]
    condition: float


def solve_base(
    full: Float64[np.ndarray, "T J P"],
    load: Float64[np.ndarray, "T J"],
    count: Float64[np.ndarray, "T J"],
    group: Int[np.ndarray, "T"],
    structural: BaseStructure,
) -> Solution:
    """Fit the base parameters.

    Args:
        full: columns of all parameters.
        load: torques.
        count: weight of each torque; 0 leaves it out.
        group: number of the motion of each row, from 0, not decreasing.
        structural: the base parameters of the mechanism.
    """
    counted = full * (count > 0.0)[:, :, None]
    base = counted[:, :, list(structural.kept)]
    shown = find_base(base.reshape(-1, structural.rank), [""] * structural.rank, tolerance=_EXCITED)
    kept = [structural.kept[number] for number in shown.kept]
    structure = BaseStructure(structural.names, tuple(kept), shown.groups @ structural.groups)
    columns = full[:, :, kept]
    values, noise = _weighted(columns, load, count)
    residual = load - columns @ values
    scaled = columns * (np.sqrt(count) / noise)[:, :, None]
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    grams = np.stack([_gram(part) for part in np.split(scaled, starts[1:])])
    scores = np.einsum("tjk,tj->tk", scaled, residual * np.sqrt(count) / noise)
    information = grams.sum(axis=0)
    sizes = np.sqrt(np.diag(information))
    condition = float(np.sqrt(np.linalg.cond(information / np.outer(sizes, sizes))))
    return Solution(structure, values, robust_covariance(grams, scores, group), information, condition)


def _weighted(
    columns: Float64[np.ndarray, "T J K"], load: Float64[np.ndarray, "T J"], count: Float64[np.ndarray, "T J"]
) -> tuple[Float64[np.ndarray, "K"], Float64[np.ndarray, "J"]]:
    """Estimates, and the standard deviation of each joint's noise by which its rows were divided."""
    root = np.sqrt(count)
    # Each joint's rows are folded into a triangle once; the rounds work on those.
    folded = [
        np.asarray(np.linalg.qr(np.column_stack([columns[:, joint], load[:, joint]]) * root[:, joint, None], mode="r"))
        for joint in range(load.shape[1])
    ]
    counted = np.maximum(count.sum(axis=0), 1.0)
    floor = _LEAST_NOISE * max(float(np.abs(load).max()), 1e-9)
    noise = np.ones(load.shape[1])
    values = np.zeros(columns.shape[2])
    for _ in range(_ROUNDS):
        stacked = np.concatenate([part / scale for part, scale in zip(folded, noise, strict=True)])
        sizes = np.linalg.norm(stacked[:, :-1], axis=0)
        values = np.linalg.lstsq(stacked[:, :-1] / sizes, stacked[:, -1], rcond=None)[0] / sizes
        squares = np.array([float(np.sum((part[:, -1] - part[:, :-1] @ values) ** 2)) for part in folded])
        noise = np.maximum(np.sqrt(squares / counted), floor)
    return values, noise


def _gram(part: Float64[np.ndarray, "T J K"]) -> Float64[np.ndarray, "K K"]:
    flat = part.reshape(-1, part.shape[2])
    return np.asarray(flat.T @ flat)
